"""The prior of rotations about axes that joints hardly rotate about."""

import jax
import jax.numpy as jnp
import numpy as np

from jaxcap.body.pose import Pose, rest_pose
from jaxcap.body.skeleton import dof_layout, make_skeleton
from jaxcap.geometry import rotation
from jaxcap.markers.calibration.rotation_prior import (
    STIFF_VARIANCE_RATIO,
    estimate_rotation_prior,
    rotation_prior_equations,
)


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
    np.testing.assert_allclose(stiff[1:], 1 / (STIFF_VARIANCE_RATIO * (1e-6 + 1e-7)), rtol=0.3)
