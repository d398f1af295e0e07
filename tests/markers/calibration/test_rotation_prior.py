"""The prior of rotations about axes that joints hardly rotate about."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxcap.body.pose import Pose, rest_pose
from jaxcap.body.skeleton import dof_layout, make_skeleton
from jaxcap.geometry import rotation
from jaxcap.markers.calibration.rotation_prior import (
    STIFF_VARIANCE_RATIO,
    WIDE_DEVIATION,
    estimate_rotation_prior,
    rotation_prior_equations,
    rotation_vectors_from_mean,
    with_wide_posture,
)
from jaxcap.markers.motion.inverse_kinematics import solve_markers
from tests.markers_limb import moving, seen_by, truth, wrong


def test_stiff_axes_beside_free_ones_have_no_negative_curvature_in_float32():
    """A joint that bends about an oblique axis only, and a bone that is known to a thousandth of a radian."""
    skeleton = make_skeleton(
        ["pelvis", "thigh"], [-1, 0], ["free", "ball"], np.array([[0.0, 1.0, 0.0], [0.0, 0.6, 0.0]])
    )
    axis = np.array([2.0, 1.0, -1.0]) / 6**0.5
    turns = np.sin(np.arange(40.0))[:, None] * axis
    pose = rest_pose(skeleton)
    q = jnp.tile(pose.rotations, (40, 1, 1)).at[:, 1].set(jax.vmap(rotation.exp)(jnp.asarray(turns)))
    poses = Pose(jnp.zeros((40, 2, 3)), q, jnp.ones(40))
    slots = dof_layout(skeleton).rotations[1]
    narrow = jax.tree.map(lambda leaf: leaf.astype(jnp.float32), (skeleton, poses))
    prior = estimate_rotation_prior(
        *narrow, 1e-7 * jnp.eye(skeleton.num_dofs, dtype=jnp.float32)[None].repeat(40, 0)
    )
    matrix, _ = rotation_prior_equations(skeleton, jax.tree.map(lambda leaf: leaf.astype(float), prior), pose)
    stiff = np.linalg.eigvalsh(np.asarray(matrix)[np.ix_(slots, slots)])
    assert stiff[0] > -1e-6 * stiff[-1] * np.finfo(np.float32).eps
    # the free axis has a wide prior
    np.testing.assert_allclose(stiff[0], WIDE_DEVIATION**-2, rtol=0.1)
    np.testing.assert_allclose(stiff[1:], 1 / (STIFF_VARIANCE_RATIO * (1e-6 + 1e-7)), rtol=0.3)


def test_a_bone_with_two_markers_does_not_spin():
    """The line through both is 5 mm from the joint, less than the errors of the template."""
    rng = np.random.default_rng(3)
    subject, motion = truth(), moving(rng, 60, size=0.3)
    pair = subject.skeleton.centres[2] + jnp.array([[0.05, 0.005, 0.0], [0.13, 0.005, 0.0]])
    offsets, weights = subject.offsets.at[8:10].set(pair), subject.weights.at[10].set(0.0)
    subject = eqx.tree_at(lambda s: (s.offsets, s.weights), subject, (offsets, weights))
    template, frames = wrong(subject, rng), seen_by(subject, motion, rng)

    def spread(poses):
        return np.sqrt(np.mean(rotation_vectors_from_mean(np.asarray(poses.rotations))[:, 2] ** 2))

    assert spread(solve_markers(template, frames).motion.poses) > 2.0 * spread(motion.poses)
    wide = with_wide_posture(template)
    assert spread(solve_markers(wide, frames).motion.poses) < 1.5 * spread(motion.poses)
    assert with_wide_posture(wide) is wide
