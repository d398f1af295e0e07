"""Retraction and difference, and what each kind of joint keeps."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import awkward_poses, chain_skeleton, half_turned_pose, random_pose

from jaxcap.body import pose as poses
from jaxcap.body import retraction
from jaxcap.body.kinematics import forward_kinematics
from jaxcap.body.skeleton import dof_layout
from jaxcap.geometry import rotation

SKELETON = chain_skeleton()
retract, difference = eqx.filter_jit(retraction.retract), eqx.filter_jit(retraction.difference)


@eqx.filter_jit
def places_of(skeleton, pose):
    return forward_kinematics(skeleton, pose).translations


def same_pose(a, b, tolerance: float = 1e-12):
    np.testing.assert_allclose(a.translations, b.translations, atol=tolerance)
    np.testing.assert_allclose(rotation.distance(a.rotations, b.rotations), 0.0, atol=1e-7)
    np.testing.assert_allclose(
        rotation.to_matrix(a.rotations), rotation.to_matrix(b.rotations), atol=tolerance
    )
    np.testing.assert_allclose(a.scale, b.scale)


@pytest.mark.parametrize("number", range(5))
def test_difference_inverts_retract(number, rng):
    start = awkward_poses(SKELETON)[number]
    for size in (0.0, 1e-9, 1e-4, 0.5):
        d = jnp.asarray(size * rng.normal(size=SKELETON.num_dofs))
        np.testing.assert_allclose(difference(SKELETON, start, retract(SKELETON, start, d)), d, atol=1e-11)


def test_retract_inverts_difference_also_near_half_turns(rng):
    for end in [
        random_pose(SKELETON, rng, 1.0),
        half_turned_pose(SKELETON, rng),
        half_turned_pose(SKELETON, rng, 1e-6),
    ]:
        for start in (poses.rest_pose(SKELETON), random_pose(SKELETON, rng, 1.0)):
            same_pose(retract(SKELETON, start, difference(SKELETON, start, end)), end, 1e-9)


def test_quaternions_stay_unit_and_on_the_shortest_arc(rng):
    pose = poses.rest_pose(SKELETON)
    for _ in range(30):
        pose = retract(SKELETON, pose, jnp.asarray(rng.normal(size=SKELETON.num_dofs)))
        np.testing.assert_allclose(jnp.linalg.norm(pose.rotations, axis=1), 1.0, atol=1e-14)
        assert (np.asarray(pose.rotations[:, 0]) >= 0).all()


def test_each_kind_moves_as_it_may(rng):
    pose = poses.rest_pose(SKELETON)
    for _ in range(4):
        pose = retract(SKELETON, pose, jnp.asarray(rng.normal(size=SKELETON.num_dofs)))
    for joint, kind in enumerate(SKELETON.kinds):
        q, axis = pose.rotations[joint], SKELETON.axes[joint, 0]
        moved = float(jnp.abs(pose.translations[joint]).max()) > 0
        turned = float(rotation.distance(q, rotation.identity())) > 1e-6
        assert moved == (kind in ("free", "translate"))
        assert turned == (kind not in ("fixed", "translate"))
        if kind == "revolute":
            np.testing.assert_allclose(rotation.rotate(q, axis), axis, atol=1e-14)


def test_a_turn_of_a_ball_joint_is_in_its_own_frame(rng):
    start = random_pose(SKELETON, rng, 1.0)
    joint = SKELETON.index("chest")
    slots = dof_layout(SKELETON).rotations[joint]
    w = jnp.array([0.2, -0.4, 0.3])
    end = retract(SKELETON, start, jnp.zeros(SKELETON.num_dofs).at[slots].set(w))
    expected = rotation.to_matrix(start.rotations[joint]) @ jax.scipy.linalg.expm(rotation.skew(w))
    np.testing.assert_allclose(rotation.to_matrix(end.rotations[joint]), expected, atol=1e-13)


def test_angles_add_up_and_come_back(rng):
    joint, pair = SKELETON.index("elbow"), SKELETON.index("spine")
    layout = dof_layout(SKELETON)
    elbow, spine = layout.rotations[joint, 0], layout.rotations[pair, :2]
    start = poses.rest_pose(SKELETON)
    for first, second in ((0.3, -0.4), (-1.2, 2.9), (3.0, 1.5), (0.0, 3.1)):
        d = jnp.zeros(SKELETON.num_dofs).at[elbow].set(first).at[spine].set(jnp.array([first, second]))
        pose = retract(SKELETON, start, d)
        assert float(poses.revolute_angles(SKELETON, pose)[joint]) == pytest.approx(first, abs=1e-13)
        np.testing.assert_allclose(poses.universal_angles(SKELETON, pose)[pair], [first, second], atol=1e-13)
        # R = Rot(axis 0, first) Rot(axis 1, second)
        turns = [
            rotation.about_axis(SKELETON.axes[pair, i], jnp.asarray(a)) for i, a in enumerate((first, second))
        ]
        expected = rotation.to_matrix(turns[0]) @ rotation.to_matrix(turns[1])
        np.testing.assert_allclose(rotation.to_matrix(pose.rotations[pair]), expected, atol=1e-13)


def test_project_keeps_what_is_allowed_and_takes_the_rest_away(rng):
    allowed = random_pose(SKELETON, rng, 0.8)
    same_pose(retraction.project(SKELETON, allowed), allowed)
    anyhow = poses.Pose(
        jnp.asarray(rng.normal(size=(SKELETON.num_joints, 3))),
        rotation.exp(jnp.asarray(rng.normal(size=(SKELETON.num_joints, 3)))),
        jnp.asarray(1.2),
    )
    once = retraction.project(SKELETON, anyhow)
    same_pose(retraction.project(SKELETON, once), once)
    # what is left is within reach of a tangent from rest
    rest = eqx.tree_at(lambda p: p.scale, poses.rest_pose(SKELETON), jnp.asarray(1.2))
    same_pose(retract(SKELETON, rest, difference(SKELETON, rest, once)), once, 1e-10)


def test_motions_stack_and_slice(rng):
    frames = [random_pose(SKELETON, rng, 0.5) for _ in range(6)]
    motion = poses.stack_poses(frames, rate=30.0)
    assert motion.num_frames == 6
    same_pose(motion[4], frames[4])
    half = motion.slice(slice(1, None, 2))
    assert half.num_frames == 3
    assert half.rate == 15.0
    same_pose(half[1], frames[3])
    places = jax.jit(jax.vmap(lambda pose: places_of(SKELETON, pose)))(motion.poses)
    np.testing.assert_allclose(places[2], places_of(SKELETON, frames[2]), atol=1e-13)


def test_thousands_of_poses_are_stacked_without_compiling(rng):
    """As NumPy stacks them; where poses are traced, derivatives go through."""
    several = [random_pose(SKELETON, rng, 0.3) for _ in range(3)]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(jnp, "stack", None)
        motion = poses.stack_poses(several * 2000, 25.0)
    assert (len(motion), motion.rate) == (6000, 25.0)
    np.testing.assert_array_equal(motion.poses.rotations[:3], np.stack([pose.rotations for pose in several]))
    same_pose(motion[5999], several[2])
    slope = jax.grad(
        lambda x: jnp.sum(poses.stack_poses([eqx.tree_at(lambda p: p.scale, several[0], x)] * 2).poses.scale)
    )
    assert slope(1.0) == 2.0
    with pytest.raises(ValueError, match="stack_poses: `poses` is empty"):
        poses.stack_poses([])
