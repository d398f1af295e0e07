"""Limits learned from samples: keyframes, projections, and known limits."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from rotation_samples import quaternions, samples_of
from scipy.spatial.transform import Rotation

from jaxcap.body.body import Body
from jaxcap.body.pose import Motion, Pose, rest_pose
from jaxcap.body.skeleton import make_skeleton
from jaxcap.body.skin import RigidSkin
from jaxcap.edit.ik.constraints import Constraint, make_constraints
from jaxcap.edit.ik.solve_ik import IkOptions, solve_ik
from jaxcap.errors import InputError
from jaxcap.limits.abstract_limits import allowed
from jaxcap.limits.compare import compare_samples
from jaxcap.limits.frame_evaluation import allowed_frames, comfort_frames, nearest_frames, residual_frames
from jaxcap.limits.implicit_surface import SurfaceLimits, comfort
from jaxcap.limits.learning.boxes import learn_boxes
from jaxcap.limits.learning.learn_limits import learn_limits
from jaxcap.limits.learning.marker_frames import arm_samples
from jaxcap.limits.learning.samples import JointSamples, gather_samples, parse_joints
from jaxcap.limits.motion_projection import project_motion
from jaxcap.limits.primitives import signed_distance
from jaxcap.limits.rest_poses.transfer import transfer_limits
from jaxcap.observe.markers import make_markers

SHOULDER = make_skeleton(
    ("shoulder", "elbow"),
    (-1, 0),
    ("ball", "revolute"),
    [[0.0, 0, 0], [0.3, 0, 0]],
    axes=[[[0.0, 0, 1], [0, 1, 0]]] * 2,
)


def motion(shoulder: np.ndarray, bend: np.ndarray) -> Motion:
    """Of `SHOULDER`: quaternions of the shoulder, angles of the elbow."""
    elbow = quaternions(Rotation.from_rotvec(bend[:, None] * np.array([0.0, 0, 1])))
    count = len(bend)
    return Motion(
        Pose(jnp.zeros((count, 2, 3)), jnp.asarray(np.stack([shoulder, elbow], 1)), jnp.ones(count)), 30.0
    )


def coupled(rng, count: int = 6000) -> Motion:
    """A shoulder that turns up to 40 degrees any way, and an elbow that bends from 0 to 90 degrees before it and
    to 20 behind it: by 55 - 35 sin-like of how far the shoulder is turned about z."""
    vector = rng.normal(size=(count, 3))
    vector *= (np.radians(40) * np.cbrt(rng.uniform(size=count)) / np.linalg.norm(vector, axis=1))[:, None]
    top = most(vector[:, 2])
    return motion(quaternions(Rotation.from_rotvec(vector)), rng.uniform(0, 1, count) * top)


def most(turn: np.ndarray) -> np.ndarray:
    return np.radians(55) + np.radians(35) * turn / np.radians(40)


@pytest.fixture(scope="module")
def learned() -> tuple[SurfaceLimits, JointSamples]:
    samples = gather_samples([(SHOULDER, coupled(np.random.default_rng(0)))], "elbow", "shoulder")
    assert samples.parent is not None
    limits = learn_limits(
        {"shoulder": samples.parent, "elbow": samples}, voxel=np.radians(6), keyframe=np.radians(10)
    )
    return limits, samples


def test_learned_limits_know_the_analytic_ones(learned, rng):
    limits, _ = learned
    vector = rng.normal(size=(4000, 3))
    size = np.radians(80) * np.cbrt(rng.uniform(size=4000))
    vector *= (size / np.linalg.norm(vector, axis=1))[:, None]
    bend = rng.uniform(-0.8, 2.4, 4000)
    told = np.asarray(
        allowed_frames(limits, SHOULDER, motion(quaternions(Rotation.from_rotvec(vector)), bend))
    )
    truth = size <= np.radians(40)
    clear = np.abs(size - np.radians(40)) > np.radians(8)
    assert (told[clear, 0] == truth[clear]).mean() > 0.99
    slack = np.minimum(bend, most(vector[:, 2]) - bend)
    clear = (np.abs(slack) > np.radians(12)) & (size < np.radians(36))
    assert clear.sum() > 100
    assert (told[clear, 1] == (slack[clear] > 0)).mean() > 0.98


def test_all_samples_are_allowed(learned):
    limits, _samples = learned
    told = allowed_frames(limits, SHOULDER, coupled(np.random.default_rng(0)))
    assert float(told[:, 0].mean()) == 1.0
    assert float(told[:, 1].mean()) > 0.995


def test_a_childs_limits_go_on_smoothly_with_its_parent(learned):
    """Along a path of the parent across many keyframes the residual makes no jumps."""
    surface = learned[0].surfaces[1]
    ends = jnp.array([[-0.25, 0.05, -0.2], [0.25, -0.1, 0.25]])
    steps = jnp.linspace(0, 1, 2001)[:, None]
    path = ends[0] * (1 - steps) + ends[1] * steps
    child = jnp.array([0.7, 0.0, 0.0])
    value = jax.jit(jax.vmap(lambda p: signed_distance(surface.primitives(p), child)))
    found = np.asarray(value(path))
    assert np.ptp(found) > 0.2
    assert np.abs(np.diff(found)).max() < 0.01


def test_shares_of_keyframes_sum_to_one_and_prefer_the_nearest(learned, rng):
    surface = learned[0].surfaces[1]
    for key in rng.integers(0, len(surface.keys), 10):
        shares = surface.keyframe_weights(surface.keys[key])
        assert float(shares.sum()) == pytest.approx(1.0)
        assert int(jnp.argmax(shares)) == key
        assert float(shares[key]) > 0.9


def test_nearest_poses_are_allowed_and_stay(learned, rng):
    limits, _ = learned
    wild = motion(quaternions(Rotation.random(300, random_state=5)), rng.uniform(-3, 3, 300))
    found = nearest_frames(limits, SHOULDER, wild)
    assert bool(allowed_frames(limits, SHOULDER, found).all())
    again = nearest_frames(limits, SHOULDER, found)
    np.testing.assert_allclose(again.poses.rotations, found.poses.rotations, atol=1e-12)
    calm = coupled(rng, 50)
    kept = np.asarray(allowed_frames(limits, SHOULDER, calm)).all(1)
    stayed = nearest_frames(limits, SHOULDER, calm)
    assert (np.asarray(stayed.poses.rotations)[kept] == np.asarray(calm.poses.rotations)[kept]).all()


def test_a_motion_is_turned_back_smoothly_and_its_allowed_frames_stay(learned):
    limits, _ = learned
    swing = np.radians(80) * np.sin(np.linspace(0, 2 * np.pi, 120))
    shoulder = quaternions(Rotation.from_rotvec(swing[:, None] * np.array([0.0, 1.0, 0.3])))
    moving = motion(shoulder, np.full(120, np.radians(30)))
    fixed = project_motion(limits, SHOULDER, moving)
    assert bool(allowed_frames(limits, SHOULDER, fixed).all())
    before, after = np.asarray(moving.poses.rotations), np.asarray(fixed.poses.rotations)
    kept = np.asarray(allowed_frames(limits, SHOULDER, moving)).all(1)
    assert kept.any()
    assert not kept.all()
    assert (after[kept] == before[kept]).all()

    # what turns joints back is smoother than where every frame finds its nearest place by itself
    def roughness(quats):
        turns = Rotation.from_quat(before[:, 0], scalar_first=True).inv() * Rotation.from_quat(
            quats[:, 0], scalar_first=True
        )
        return np.linalg.norm(np.diff(turns.as_rotvec(), 2, axis=0))

    apart, drawn = (project_motion(limits, SHOULDER, moving, seconds) for seconds in (0.0, 0.2))
    assert roughness(np.asarray(drawn.poses.rotations)) < 0.9 * roughness(np.asarray(apart.poses.rotations))


def test_comfort_is_high_in_the_crowd_and_none_where_nobody_was(learned):
    limits, _ = learned
    frames = coupled(np.random.default_rng(1), 500)
    scores = np.asarray(comfort_frames(limits, SHOULDER, frames))
    assert scores.shape == (500, 2)
    # of the distribution's own samples, ranks are about even
    assert 0.35 < scores[:, 0].mean() < 0.65
    far = motion(quaternions(Rotation.from_rotvec([[0, 2.5, 0]])), np.array([-2.0]))
    assert np.asarray(comfort_frames(limits, SHOULDER, far)).max() < 0.02


def test_residuals_are_about_how_far_a_joint_is_beyond(learned):
    limits, _ = learned
    for degrees in (60, 75, 90):
        turned = quaternions(Rotation.from_rotvec([[0.0, np.radians(degrees), 0.0]]))
        frames = motion(turned, np.array([np.radians(30)]))
        beyond = float(residual_frames(limits, SHOULDER, frames)[0, 0])
        # the samples end at 40 degrees, voxels of six a little later; a chart shortens large turns
        assert (
            np.radians(degrees - 40) * 0.7 < beyond + np.radians(8) < np.radians(degrees - 40) + np.radians(8)
        )


def test_voxels_are_chosen_so_that_most_of_what_was_held_out_is_allowed():
    frames = coupled(np.random.default_rng(4), 6000)
    samples = gather_samples([(SHOULDER, frames)], "elbow", "shoulder")
    assert samples.parent is not None
    limits = learn_limits({"shoulder": samples.parent, "elbow": samples}, coverage=0.98)
    fresh = coupled(np.random.default_rng(5), 1000)
    told = np.asarray(allowed_frames(limits, SHOULDER, fresh))
    assert told.mean(0).min() > 0.96


def test_boxes_are_the_ends_of_euler_angles(rng):
    angles = rng.uniform([-0.5, -0.2, -1.0], [0.3, 0.9, 0.4], (3000, 3))
    turned = quaternions(Rotation.from_euler("xyz", angles))
    frames = motion(turned, rng.uniform(0.1, 1.2, 3000))
    samples = gather_samples([(SHOULDER, frames)], "elbow", "shoulder")
    assert samples.parent is not None
    ranges, boxes = learn_boxes(SHOULDER, [samples.parent, samples])
    np.testing.assert_allclose(boxes.lower[0], angles.min(0), atol=1e-6)
    np.testing.assert_allclose(boxes.upper[0], angles.max(0), atol=1e-6)
    np.testing.assert_allclose([ranges.lower[0], ranges.upper[0]], [0.1, 1.2], atol=2e-3)


def test_two_subjects_are_as_alike_as_their_ranges(rng):
    wide, narrow = (
        samples_of(Rotation.from_rotvec(size * rng.uniform(-1, 1, (800, 3)))) for size in (0.8, 0.4)
    )
    assert compare_samples(wide, wide).mean == 0.0
    apart = compare_samples(wide, narrow)
    assert apart.mean > 2 * compare_samples(wide, wide._replace(rotations=wide.rotations[::2])).mean


def test_joints_are_parsed_with_parents_first():
    assert parse_joints("elbow:hand,shoulder:elbow,head") == (
        ("elbow", "shoulder"),
        ("hand", "elbow"),
        ("head", None),
    ) or parse_joints("elbow:hand,shoulder:elbow,head")[0] == ("shoulder", None)
    assert parse_joints("a:b:c") == (("a", None), ("b", "a"), ("c", "b"))


@pytest.mark.parametrize(
    ("text", "words"), [("a::b", "empty"), ("a:b,c:b", "choose one"), ("a:b,b:a", "has a cycle")]
)
def test_joints_that_cannot_be_are_told(text, words):
    with pytest.raises(InputError, match=words):
        parse_joints(text)


def test_missing_and_fixed_joints_are_told():
    frames = coupled(np.random.default_rng(0), 10)
    with pytest.raises(ValueError, match="there is no joint 'knee'"):
        gather_samples([(SHOULDER, frames)], "knee")
    stiff = eqx.tree_at(lambda s: s.centres, SHOULDER, SHOULDER.centres)
    stiff = make_skeleton(stiff.names, stiff.parents, ("ball", "fixed"), stiff.centres)
    with pytest.raises(ValueError, match="does not rotate"):
        gather_samples([(stiff, frames)], "elbow")


def test_inverse_kinematics_stays_within_learned_limits(learned):
    """A hand that is pulled to where the shoulder would have to turn by 90 degrees ends about as near as any sample."""
    limits, _ = learned
    hand = jnp.array([[0.6, 0.0, 0.0], [0.6, 0.01, 0.0], [0.6, 0.0, 0.01]])
    body = Body(SHOULDER, RigidSkin(jnp.array([1, 1, 1])), hand, jnp.array([[0, 1, 2]]))
    target, rest = (0.0, 0.3, -0.5), rest_pose(SHOULDER)
    wanted = make_constraints(body, [Constraint(0, target)])
    kept = solve_ik(body, rest, wanted, IkOptions(limits=limits))
    assert allowed(limits, SHOULDER, kept.pose).all()
    broken = solve_ik(body, rest, wanted)
    assert not allowed(limits, SHOULDER, broken.pose).all()
    frames = coupled(np.random.default_rng(7), 20000)
    shoulder, elbow = (
        Rotation.from_quat(np.asarray(frames.poses.rotations[:, j]), scalar_first=True) for j in range(2)
    )
    hands = shoulder.apply(elbow.apply([0.3, 0.0, 0.0]) + [0.3, 0.0, 0.0])
    nearest = np.linalg.norm(hands - target, axis=1).min()
    assert float(broken.distances[0]) + 0.1 < float(kept.distances[0]) < nearest + 0.01


def test_limits_tell_which_joints_a_skeleton_lacks(learned):
    other = make_skeleton(("hip", "elbow"), (-1, 0), ("ball", "revolute"), np.zeros((2, 3)))
    kept = transfer_limits(learned[0], SHOULDER, {}).surfaces
    assert all(one is two for one, two in zip(kept, learned[0].surfaces, strict=True))
    with pytest.raises(InputError, match="'shoulder' is not among the joints hip, elbow"):
        transfer_limits(learned[0], other, {})


def test_comfort_of_one_pose_is_that_of_its_frame(learned):
    frames = coupled(np.random.default_rng(2), 3)
    np.testing.assert_allclose(
        comfort(learned[0], SHOULDER, frames[1]), comfort_frames(learned[0], SHOULDER, frames)[1]
    )


def test_arms_of_markers_turn_as_the_markers_do(rng):
    """Markers of an arm that is posed by known angles, on a trunk that tumbles."""
    flexion = rng.uniform(0.3, 2.0, 60)
    shoulder = Rotation.from_rotvec(0.5 * rng.normal(size=(60, 3)))
    trunk = Rotation.random(60, random_state=8)
    still = np.array([[0.0, 0, 0], [0.12, 0, 0], [0.3, 0, 0]])
    forearm = np.stack([0.3 + 0.25 * np.cos(flexion), 0 * flexion, 0.25 * np.sin(flexion)], 1)
    places = [(trunk * shoulder).apply(np.tile(point, (60, 1))) for point in still]
    places.append((trunk * shoulder).apply(forearm))
    places += [trunk.apply(np.tile(p, (60, 1))) for p in ([0.0, 0.4, 0], [0.5, 0.4, 0], [0, 0.4, 0.5])]
    labels = ("SHO", "UPA", "ELB", "FRM", "T1", "T2", "T3")
    frames = make_markers(np.stack(places, 1), labels, 100.0)
    upper, lower = arm_samples(frames, labels[:4], labels[4:])
    # frames differ from the truth by one fixed turn of the trunk's axes and of the arm's
    found = Rotation.from_quat(upper.rotations, scalar_first=True)
    relative = found[0].inv() * found[7]
    assert relative.magnitude() == pytest.approx((shoulder[0].inv() * shoulder[7]).magnitude(), abs=1e-9)
    bends = Rotation.from_quat(lower.rotations, scalar_first=True)
    np.testing.assert_allclose((bends[0].inv() * bends).magnitude(), np.abs(flexion - flexion[0]), atol=1e-9)
    with pytest.raises(InputError, match="There is no marker 'XXX'"):
        arm_samples(frames, ("XXX", *labels[1:4]), labels[4:])
