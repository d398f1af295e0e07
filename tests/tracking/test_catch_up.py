"""A body that jumps between two frames is reached again without a search; starts near unsupported limbs; survivors."""

import time

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from scipy.spatial import cKDTree

from jaxcap.body.body import pose_body
from jaxcap.body.people.human import human
from jaxcap.body.pose import Pose, rest_pose
from jaxcap.body.retraction import difference, retract
from jaxcap.body.skeleton import dof_layout
from jaxcap.geometry.mesh import sample_surface
from jaxcap.metrics import joint_errors
from jaxcap.observe.clouds import make_cloud, missing_cloud
from jaxcap.stacking import stack_trees
from jaxcap.tracking import advance, online
from jaxcap.tracking.search.anneal import SEGMENT, anneal_sorted, anneal_survivors
from jaxcap.tracking.search.catch_up import EXTRAPOLATIONS, extrapolated_poses
from jaxcap.tracking.search.initialise import FINE_SIGMAS
from jaxcap.tracking.search.starts import SUPPORT_RADIUS, subtree_starts, unsupported_shares
from jaxcap.tracking.track import track_frames
from jaxcap.tracking.track_frame import TrackState, make_tracker, start_state

BODY = human(resolution="low", joints="tracking")
SKELETON, LAYOUT = BODY.skeleton, dof_layout(BODY.skeleton)
TRACKER = make_tracker(BODY)
_pose_body = eqx.filter_jit(pose_body)


def moved(pose: Pose, place=(0.0, 0.0, 0.0), **turns) -> Pose:
    """Move the root, and rotate joints about their own axes, radians."""
    change = np.zeros(SKELETON.num_dofs)
    change[LAYOUT.translations[0]] = place
    for name, turn in turns.items():
        change[LAYOUT.rotations[SKELETON.index(name)]] = turn
    return retract(SKELETON, pose, jnp.asarray(change))


def scan(pose: Pose, rng):
    points, normals = sample_surface(
        np.asarray(_pose_body(BODY, pose).vertices), np.asarray(BODY.faces), 600, rng
    )
    return make_cloud(points + 0.003 * rng.normal(size=points.shape), normals)


def joint_error(a: Pose, b: Pose) -> float:
    """Compute the mean distance of joint centres, metres."""
    joints = (np.asarray(_pose_body(BODY, pose).joints)[None] for pose in (a, b))
    return float(joint_errors(*joints).mean())


REST = rest_pose(SKELETON)
# far from the last frame: a step to the side, and both arms and a leg elsewhere
JUMPED = moved(REST, (0.3, 0.1, -0.1), LeftArm=[0, 0, -0.5], RightArm=[0.6, 0.3, 0], RightUpLeg=[-0.7, 0, 0])


def test_a_body_that_jumps_is_reached_without_a_search(rng, monkeypatch):
    clouds = [scan(pose, rng) for pose in (REST, REST, JUMPED)]
    searches = []
    frames = list(track_frames(TRACKER, clouds, REST, sigma=0.03, on_search=searches.append))
    assert [frame.verdict for frame in frames] == ["good"] * 3
    assert not searches and frames[-1].searches.count == 0
    assert joint_error(frames[-1].pose, JUMPED) < 0.02
    # the next prediction continues the jump
    change = difference(SKELETON, frames[1].pose, frames[2].pose)
    np.testing.assert_allclose(frames[2].state.change, change, atol=1e-5)
    # steps of tracking alone do not reach it
    monkeypatch.setattr(advance, "needs_search", lambda frame: False)
    plain = list(track_frames(TRACKER, clouds, REST, sigma=0.03))
    assert plain[-1].verdict != "good"
    assert joint_error(plain[-1].pose, JUMPED) > 0.04


def test_no_velocity_is_made_of_a_gap(rng):
    """After frames without a person the body is elsewhere: the whole way is no change within one frame."""
    clouds = [scan(REST, rng), missing_cloud("nobody is there."), scan(JUMPED, rng)]
    frames = list(track_frames(TRACKER, clouds, REST, sigma=0.03))
    assert [frame.verdict for frame in frames] == ["good", "lost", "good"]
    assert joint_error(frames[2].pose, JUMPED) < 0.02
    assert not np.asarray(frames[2].state.change).any()


def test_a_live_tracker_needs_no_search_for_a_jump(rng, monkeypatch):
    def refuse(*_):
        raise AssertionError("searched")

    monkeypatch.setattr(online, "search_frame", refuse)
    tracker, cloud = online.OnlineTracker(TRACKER, REST, sigma=0.03), scan(JUMPED, rng)
    frames = [tracker.track(scan(REST, rng)), tracker.track(scan(REST, rng)), tracker.track(cloud)]
    assert [frame.verdict for frame in frames[:2]] == ["good"] * 2 and frames[2].verdict != "good"
    deadline = time.monotonic() + 60
    while tracker.is_searching and time.monotonic() < deadline:
        time.sleep(0.05)
    found = tracker.track(cloud)
    tracker.close()
    assert (found.verdict, found.searches.count) == ("good", 0)
    assert joint_error(found.pose, JUMPED) < 0.02


def test_hypotheses_continue_the_last_change(rng):
    state = start_state(TRACKER, JUMPED)
    change = jnp.asarray(0.1 * rng.normal(size=SKELETON.num_dofs))
    poses = extrapolated_poses(SKELETON, TrackState(state.estimate, change))
    for number, share in enumerate(EXTRAPOLATIONS):
        pose = jax.tree.map(lambda leaf, number=number: leaf[number], poses)
        expected = retract(SKELETON, JUMPED, share * change)
        assert float(jnp.abs(difference(SKELETON, expected, pose)).max()) < 1e-5


def test_a_limb_without_points_is_unsupported_and_moved_first(rng):
    """The cloud has the left arm elsewhere; hips and legs are where they were."""
    cloud = scan(moved(REST, LeftArm=[0, 0, 1.2]), rng)
    shares = np.asarray(unsupported_shares(TRACKER, stack_trees([REST]), cloud))[0]
    arm = SKELETON.index("LeftForeArm")
    assert shares.shape == (SKELETON.num_joints,) and shares[arm] > 0.9
    for name in ("RightForeArm", "RightLeg", "LeftLeg"):
        assert shares[SKELETON.index(name)] < 0.35, name
    # by a tree of the points, one vertex after another
    posed, bones = _pose_body(BODY, REST), np.asarray(BODY.skin.dominant_bones())
    near = cKDTree(np.asarray(cloud.points)).query_ball_point(np.asarray(posed.vertices), SUPPORT_RADIUS)
    alone = [
        not (np.asarray(cloud.normals)[rows] @ np.asarray(normal) > 0.5).any()
        for rows, normal in zip(near, posed.normals, strict=True)
    ]
    expected = [
        np.mean(np.asarray(alone)[below[bones]]) if below[bones].any() else 0.0
        for below in np.asarray(SKELETON.descendants)
    ]
    np.testing.assert_allclose(shares, expected, atol=1e-5)
    # without normals any near point supports the surface
    plain = eqx.tree_at(lambda c: c.normals, cloud, 0.0 * cloud.normals)
    bare = np.asarray(unsupported_shares(TRACKER, stack_trees([REST]), plain))[0]
    assert bare[arm] > 0.8 and (bare <= shares + 1e-6).all()

    deviations = jnp.full(SKELETON.num_dofs, 0.3)

    def share_of_arm(unsupported):
        starts = subtree_starts(
            SKELETON, stack_trees([REST]), 200, deviations, jax.random.key(0), unsupported
        )
        turned = np.abs(np.asarray(starts.rotations) - np.asarray(REST.rotations)).max(-1) > 1e-9
        first = np.array([np.flatnonzero(row)[0] if row.any() else -1 for row in turned[1:]])
        return np.isin(first, np.flatnonzero(SKELETON.descendants[SKELETON.index("LeftArm")])).mean()

    assert share_of_arm(jnp.asarray(shares)[None]) > 2 * share_of_arm(None)


def test_few_starts_all_survive_and_poor_ones_do_not(rng):
    cloud = scan(JUMPED, rng)
    sigmas = jnp.asarray(FINE_SIGMAS[:SEGMENT], jnp.zeros(()).dtype)
    near = [moved(JUMPED, LeftArm=[0, 0, 0.05 * number]) for number in range(3)]
    far = [moved(REST, (2.0 + number, 0, 0)) for number in range(12)]
    few = stack_trees(near[::-1])
    poses = anneal_survivors(TRACKER, cloud, few, sigmas)
    expected, _ = anneal_sorted(TRACKER, cloud, few, sigmas)
    assert float(jnp.abs(poses.rotations - expected.rotations).max()) < 1e-5
    # 15 starts: 12 go on after each segment, the near ones among them and first
    poses = anneal_survivors(TRACKER, cloud, stack_trees([*far, *near]), jnp.tile(sigmas, 2))
    assert poses.rotations.shape[0] == 12
    for number in range(3):
        pose = jax.tree.map(lambda leaf, number=number: leaf[number], poses)
        assert joint_error(pose, JUMPED) < 0.03
