"""Retargeting by surfaces and by points, where the answer is known exactly."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import chain_body, chain_skeleton, random_pose

from jaxcap.body.body import posed_vertices
from jaxcap.body.kinematics import joint_paths
from jaxcap.body.pose import Motion, Pose, stack_poses
from jaxcap.body.skin import LinearSkin
from jaxcap.edit.retargeting.point_pairs import PointPair, match_points
from jaxcap.edit.retargeting.point_pairs import _solve_frames as solve_frames
from jaxcap.edit.retargeting.retarget_shape import retarget_shape
from jaxcap.edit.retargeting.transfer import make_transfer, transfer_pose
from jaxcap.geometry import rotation

FRAMES = 4


@pytest.fixture(scope="module")
def body():
    return chain_body()


@pytest.fixture(scope="module")
def motion(body):
    rng = np.random.default_rng(2)
    return stack_poses([random_pose(body.skeleton, rng, 0.15) for _ in range(FRAMES)], 25.0)


def resized(body, size):
    skeleton = eqx.tree_at(lambda s: s.centres, body.skeleton, size * body.skeleton.centres)
    return eqx.tree_at(lambda b: (b.skeleton, b.vertices), body, (skeleton, size * body.vertices))


def test_transferred_to_itself_a_surface_is_as_posed(body, motion):
    """The chain's three tubes hang together by nothing; bridges keep them where they belong."""
    rest, posed = np.asarray(body.vertices), np.asarray(posed_vertices(body, motion.poses))[0]
    transfer = make_transfer(rest, rest, np.asarray(body.faces))
    found = transfer_pose(transfer, posed)
    np.testing.assert_allclose(found, posed - posed.mean(0), atol=1e-10)
    # a rigid motion is carried over whole, and so is a size
    turn = np.asarray(rotation.to_matrix(rotation.exp(jnp.array([0.3, 1.0, -0.5]))))
    larger = make_transfer(rest, 1.7 * rest, np.asarray(body.faces))
    found = transfer_pose(larger, 2.0 * rest @ turn.T + 3.0, scale=2.0)
    np.testing.assert_allclose(found, 1.7 * (rest - rest.mean(0)) @ turn.T, atol=1e-10)


def test_other_builds_keep_their_lengths(body, motion):
    """A target that is twice as thick, bent: sides along the limb are as long as at rest."""
    rest = np.asarray(body.vertices)
    posed = np.asarray(posed_vertices(body, motion.poses))[1]
    thick = rest * [1.0, 1.5, 1.5]
    found = transfer_pose(make_transfer(rest, thick, np.asarray(body.faces)), posed)
    faces = np.asarray(body.faces)
    lengths = lambda x: np.linalg.norm(x[faces[:, 1]] - x[faces[:, 0]], axis=1)  # noqa: E731
    ratio = lengths(found) / lengths(thick)
    own = lengths(posed) / lengths(rest)
    assert np.median(np.abs(ratio / own - 1)) < 0.1


@pytest.mark.parametrize("size", [1.0, 0.7])
def test_a_body_of_another_size_does_the_same_in_its_size(body, motion, size):
    target = resized(body, size)
    found = retarget_shape(motion, body, target)
    assert found.ratio == pytest.approx(size) and found.motion.rate == 25.0
    there, here = posed_vertices(body, motion.poses), posed_vertices(target, found.motion.poses)
    want = size * np.asarray(there) + (1 - size) * np.array([0, found.floor, 0])
    # the first frame stands where the source's is, scaled, and so do all that follow
    np.testing.assert_allclose(here, want, atol=1e-5)
    np.testing.assert_allclose(
        rotation.distance(found.motion.poses.rotations, motion.poses.rotations), 0.0, atol=1e-4
    )
    assert found.rmse.max() < 1e-5
    if size == 1.0:
        np.testing.assert_allclose(
            found.motion.poses.translations[:, 0], motion.poses.translations[:, 0], atol=1e-5
        )


def test_moved_joints_take_another_pose_for_the_same_surface(body, motion):
    """Copied, the pose brings the surface elsewhere. Where the root was is of no account to what it can do; where joints
    lie otherwise, millimetres are left, as no pose turns a limb about another place than its joint's."""
    there = np.asarray(posed_vertices(body, motion.poses))
    rng = np.random.default_rng(0)
    askew = 0.03 * rng.normal(size=body.skeleton.centres.shape)
    elsewhere = np.zeros_like(askew)
    elsewhere[0] = [0.03, -0.02, 0.01]
    for offsets, least, most in ((elsewhere, 0.01, 1e-7), (askew, 0.012, 0.002)):
        moved = eqx.tree_at(lambda b: b.skeleton.centres, body, body.skeleton.centres + offsets)
        found = retarget_shape(motion, body, moved)
        copied, met = (
            np.linalg.norm(np.asarray(posed_vertices(moved, poses)) - there, axis=-1)
            for poses in (motion.poses, found.motion.poses)
        )
        assert np.sqrt(np.mean(copied**2)) > least
        assert np.sqrt(np.mean(met**2)) < most


def test_bodies_that_do_not_correspond_are_told(body, motion):
    other = eqx.tree_at(lambda b: b.faces, body, body.faces[:, ::-1])
    fewer = eqx.tree_at(
        lambda b: (b.vertices, b.skin), body, (body.vertices[:-1], LinearSkin(body.skin.weights[:-1]))
    )
    turned = eqx.tree_at(
        lambda b: b.vertices, body, body.vertices[:, jnp.array([1, 0, 2])] * jnp.array([1, -1, 1])
    )
    for target, words in (
        (other, "different triangles"),
        (fewer, "48 vertices and the target 47"),
        (turned, "same rest pose"),
    ):
        with pytest.raises(ValueError, match=words):
            retarget_shape(motion, body, target)
    with pytest.raises(ValueError, match="no frames"):
        retarget_shape(motion.slice(slice(0, 0)), body, body)


def test_points_meet_and_what_they_do_not_ask_for_stays(body, motion):
    skeleton = chain_skeleton()
    pairs = [PointPair("hand", "hand"), PointPair(40, 40, 2.0)]
    same = match_points(motion, body, body, motion, pairs)
    assert same.distances.max() < 1e-9
    np.testing.assert_allclose(same.motion.poses.rotations, motion.poses.rotations, atol=1e-7)
    # the source shifted by a centimetre, which the target's points follow
    shift = np.array([0.01, -0.004, 0.006])
    moved = Motion(
        Pose(motion.poses.translations.at[:, 0].add(shift), motion.poses.rotations, motion.poses.scale), 25.0
    )
    met = match_points(moved, body, body, motion, pairs)
    assert met.distances.max() < 5e-4
    # a joint that two ask for goes between their places, by their weights, and other points compile nothing
    traces = solve_frames._cached._cache_size()
    twice = [PointPair("hand", "hand", 3.0), PointPair("elbow", "hand", 1.0)]
    met = match_points(motion, body, body, motion, twice)
    assert solve_frames._cached._cache_size() == traces
    x = np.asarray(joint_paths(skeleton, motion.poses))[:, [skeleton.index("hand"), skeleton.index("elbow")]]
    reached = np.asarray(joint_paths(skeleton, met.motion.poses))[:, skeleton.index("hand")]
    np.testing.assert_allclose(reached, 0.75 * x[:, 0] + 0.25 * x[:, 1], atol=5e-4)
    # of skeletons without a surface, in another size, about a floor
    met = match_points(motion, skeleton, skeleton, motion, pairs[:1], ratio=1.02, floor=-0.5)
    hand = skeleton.index("hand")
    want = 1.02 * np.asarray(joint_paths(skeleton, motion.poses))[:, hand] + 0.02 * np.array([0, 0.5, 0])
    np.testing.assert_allclose(np.asarray(joint_paths(skeleton, met.motion.poses))[:, hand], want, atol=5e-4)
    for call, words in (
        (lambda: match_points(motion, body, body, motion, []), "no point pairs"),
        (
            lambda: match_points(motion, body, body, motion, [PointPair("hand", "foot")]),
            "no joint 'foot' in the target",
        ),
        (lambda: match_points(motion, body, body, motion, [PointPair(48, 0)]), "no vertex 48 in the source"),
        (lambda: match_points(motion, body, skeleton, motion, [PointPair(3, 3)]), "without a surface"),
        (
            lambda: match_points(motion, body, body, motion, [PointPair(3, 3, 0.0)]),
            "weight of the pair 3 and 3 is 0",
        ),
        (
            lambda: match_points(motion.slice(slice(0, 2)), body, body, motion, pairs),
            "has 4 frames, and its source 2",
        ),
    ):
        with pytest.raises(ValueError, match=words):
            call()
