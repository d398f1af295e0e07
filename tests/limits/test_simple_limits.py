"""Boxes, cones and ranges under the interface of all limits: who is beyond, and the nearest pose."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import chain_body, chain_skeleton, check_energy, random_pose
from scipy.spatial.transform import Rotation

from jaxcap.body.pose import Pose, rest_pose
from jaxcap.energy.priors.joint_limits import JointLimits
from jaxcap.limits.abstract_limits import AllLimits, allowed
from jaxcap.limits.euler_boxes import EulerBox, make_euler_boxes
from jaxcap.limits.ranges_and_cones import Cone, make_joint_ranges

SKELETON = chain_skeleton()
RANGES = make_joint_ranges(
    SKELETON,
    {"elbow": (-0.3, 0.2), "spine": ((-0.1, 0.4), (-0.2, 0.3))},
    {"chest": Cone((1, 0, 0), 0.3, (0, 1, 0), 0.2)},
)
FRAME = Rotation.random(random_state=4).as_matrix()
BOXES = make_euler_boxes(
    SKELETON, {"hand": EulerBox(np.array([-0.2, -0.5, 0.1]), np.array([0.3, 0.5, 0.8]), FRAME)}
)
BOTH = AllLimits((RANGES, BOXES))


@eqx.filter_jit
def judged(limits, pose):
    return limits.residual(SKELETON, pose), allowed(limits, SKELETON, pose)


@eqx.filter_jit
def nearest(limits, pose):
    return limits.project(SKELETON, pose)


def with_hand(turn: Rotation) -> Pose:
    pose = rest_pose(SKELETON)
    quaternion = jnp.asarray(turn.as_quat(scalar_first=True))
    return Pose(pose.translations, pose.rotations.at[SKELETON.index("hand")].set(quaternion), pose.scale)


def test_boxes_know_the_euler_angles_of_scipy(rng):
    """The first axis is turned about first: SciPy's extrinsic xyz in the box's frame."""
    for angles in rng.uniform([-1.5, -1.4, -1.5], [1.5, 1.4, 1.5], (20, 3)):
        frame = Rotation.from_matrix(FRAME if np.linalg.det(FRAME) > 0 else -FRAME)
        pose = with_hand(frame * Rotation.from_euler("xyz", angles) * frame.inv())
        residual, _ = judged(BOXES, pose)
        expected = angles - np.clip(angles, [-0.2, -0.5, 0.1], [0.3, 0.5, 0.8])
        np.testing.assert_allclose(residual, expected, atol=1e-9)


def test_a_left_handed_frame_turns_the_same_ways_about_its_axes(rng):
    axes = FRAME[:, [1, 0, 2]]
    box = make_euler_boxes(
        SKELETON, {"hand": EulerBox(np.array([-0.2, -0.5, 0.1]), np.array([0.3, 0.5, 0.8]), axes)}
    )
    for angles in rng.uniform([-0.2, -0.5, 0.1], [0.3, 0.5, 0.8], (10, 3)):
        turns = [Rotation.from_rotvec(angle * axis) for angle, axis in zip(angles, axes.T, strict=True)]
        assert bool(judged(box, with_hand(turns[2] * turns[1] * turns[0]))[1].all())
    outside = Rotation.from_rotvec(-0.3 * axes[:, 2])
    assert not bool(judged(box, with_hand(outside))[1].all())


@pytest.mark.parametrize("limits", [RANGES, BOXES, BOTH], ids=["ranges", "boxes", "all"])
def test_the_nearest_pose_is_allowed_and_what_is_allowed_stays(rng, limits):
    poses = [random_pose(SKELETON, rng, size) for size in (0.05, 0.3, 0.8, 1.5)]
    for pose in poses:
        _, before = judged(limits, pose)
        found = nearest(limits, pose)
        residual, after = judged(limits, found)
        assert bool(after.all()), residual
        same = np.asarray(before)
        assert (np.asarray(found.rotations)[same] == np.asarray(pose.rotations)[same]).all()
        np.testing.assert_allclose(nearest(limits, found).rotations, found.rotations, atol=1e-5)
    assert not all(bool(judged(limits, pose)[1].all()) for pose in poses)


def test_one_cone_is_left_by_the_shortest_way():
    cone = make_joint_ranges(SKELETON, None, {"chest": Cone((1, 0, 0), 0.3, (0, 1, 0), np.pi)})
    joint = SKELETON.index("chest")
    turn = Rotation.from_rotvec([0.4, 0.9, -0.2])
    pose = rest_pose(SKELETON)
    pose = Pose(
        pose.translations,
        pose.rotations.at[joint].set(jnp.asarray(turn.as_quat(scalar_first=True))),
        pose.scale,
    )
    found = Rotation.from_quat(np.asarray(nearest(cone, pose).rotations[joint]), scalar_first=True)
    beyond = np.arccos(turn.apply([1.0, 0, 0])[0]) - 0.3
    assert (found * turn.inv()).magnitude() == pytest.approx(beyond, abs=1e-5)


def test_owners_name_the_joint_of_every_residual():
    residual, _ = judged(BOTH, rest_pose(SKELETON))
    owners = BOTH.residual_joints(SKELETON)
    assert owners.shape == residual.shape
    names = [SKELETON.names[joint] for joint in owners]
    assert names == ["elbow", "spine", "spine", "chest", "chest", "hand", "hand", "hand"]


def test_energies_of_boxes_against_central_differences(rng):
    check_energy(JointLimits(BOTH), chain_body(), [random_pose(SKELETON, rng, 0.7) for _ in range(3)])


@pytest.mark.parametrize(
    ("box", "words"),
    [
        ({"nose": EulerBox(np.zeros(3), np.ones(3), np.eye(3))}, "not in the skeleton"),
        ({"hand": EulerBox(np.ones(3), np.zeros(3), np.eye(3))}, "swap them"),
        ({"hand": EulerBox(np.zeros(3), np.ones(3), np.ones((3, 3)))}, "right angles"),
    ],
)
def test_boxes_that_cannot_be_are_told(box, words):
    with pytest.raises(ValueError, match=words):
        make_euler_boxes(SKELETON, box)


def test_ranges_without_an_end_hold_nothing():
    open_range = make_joint_ranges(SKELETON, {"elbow": (-np.inf, np.inf)})
    pose = random_pose(SKELETON, np.random.default_rng(0), 2.0)
    residual, _ = judged(open_range, pose)
    assert np.isfinite(residual).all()
    np.testing.assert_array_equal(residual, 0.0)
    slope = jax.grad(
        lambda q: jnp.sum(open_range.residual(SKELETON, Pose(pose.translations, q, pose.scale)) ** 2)
    )
    assert np.isfinite(slope(pose.rotations)).all()


def test_limits_that_overlap_hold_together(rng):
    """Two boxes of one joint along different axes: projected onto one alone, a pose may leave the other."""
    wide = np.array([0.2, 0.05, 0.2])
    first, second = (
        make_euler_boxes(
            SKELETON, {"hand": EulerBox(-wide, wide, Rotation.from_rotvec([0, 0, angle]).as_matrix())}
        )
        for angle in (0.0, 0.6)
    )
    both = AllLimits((first, second))
    alone = 0
    for turn in Rotation.random(40, random_state=1):
        pose = with_hand(turn)
        once = nearest(second, nearest(first, pose))
        alone += not bool(judged(both, once)[1].all())
        assert bool(judged(both, nearest(both, pose))[1].all())
    # the case is there
    assert alone > 5
