"""Derivatives of energies over bones, against automatic differentiation through the pose."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxcap.body.body import pose_body
from jaxcap.body.people.human import human
from jaxcap.body.pose import Pose, rest_pose
from jaxcap.body.retraction import retract
from jaxcap.energy.data.sufficient_statistics import rigid_moments
from jaxcap.energy.priors.self_collision import make_self_collision
from jaxcap.fit.frame_equations import frame_equations
from jaxcap.fit.linearise import linearise

BODY = human(resolution="low", joints="tracking")
_linearise, _equations = eqx.filter_jit(linearise), eqx.filter_jit(frame_equations)


@eqx.filter_jit
def differentiated(energy, pose):
    """The Jacobian of the residual by forward mode, through kinematics and energy."""

    def residual(d):
        return energy.residual(pose_body(BODY, retract(BODY.skeleton, pose, d)))

    return jax.jacfwd(residual)(jnp.zeros(BODY.skeleton.num_dofs))


def random_pose(rng) -> Pose:
    """A pose away from rest, moved, with a scale."""
    pose = retract(
        BODY.skeleton, rest_pose(BODY.skeleton), jnp.asarray(0.2 * rng.normal(size=BODY.skeleton.num_dofs))
    )
    return Pose(pose.translations.at[0].add(jnp.array([0.3, -0.2, 2.0])), pose.rotations, jnp.asarray(1.1))


@pytest.mark.parametrize("name", ["collision", "moments", "weighted"])
def test_bone_jacobians_are_those_of_forward_mode(name, rng):
    pose = random_pose(rng)
    if name == "collision":
        energy = make_self_collision(BODY)
        assert energy is not None
        # points at a distance count as inside
        energy = eqx.tree_at(
            lambda e: [limb.allowed for limb in e.limbs], energy, replace_fn=lambda allowed: allowed - 0.3
        )
    else:
        bones = jnp.asarray(rng.integers(0, BODY.skeleton.num_joints, 200))
        rest, points = (jnp.asarray(rng.normal(size=(200, 3))) for _ in range(2))
        energy = rigid_moments(
            bones, rest, points, jnp.asarray(rng.uniform(size=200)), BODY.skeleton.num_joints
        )
        energy = 2.5 * energy if name == "weighted" else energy
    residual, rows = _linearise(energy, BODY, pose)
    expected = np.asarray(differentiated(energy, pose))
    assert (np.abs(np.asarray(residual)) > 0).sum() > 10
    np.testing.assert_allclose(rows, expected, atol=1e-6 * np.abs(expected).max())
    # summed over each bone first, where rows depend on single bones
    value, side, matrix = _equations(energy, BODY, pose)
    np.testing.assert_allclose(value, 0.5 * float(residual @ residual), rtol=1e-6)
    for found, wanted in ((side, expected.T @ residual), (matrix, expected.T @ expected)):
        np.testing.assert_allclose(found, wanted, atol=1e-6 * np.abs(np.asarray(wanted)).max())
