"""An energy of a user's own moves a learned body; derivatives of joints and poses against central differences."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Array, Float

import jaxcap as jc
from jaxcap.body.body import deform_all
from jaxcap.errors import InputError
from jaxcap.geometry.laplacian import make_conformance
from jaxcap.learn.joints import improve_joints, make_curvature
from jaxcap.learn.loop import learn_body
from jaxcap.learn.objective import objective
from jaxcap.observe import MeshSequence
from tests.test_learn_projection import arm
from tests.test_learn_steps import NONE
from tests.test_terms import FeetOnFloor


class Hand(jc.AbstractEnergy):
    """How far a joint is from a place, millimetres."""

    place: Float[Array, "3"]

    def residual(self, posed: jc.Posed) -> Float[Array, "3"]:
        return (posed.joints[2] - self.place) / 1e-3


def lowest(body, poses) -> float:
    return float(deform_all(body, poses)[..., 1].min())


def test_a_floor_raises_learned_poses(rng):
    body, poses = arm(rng, 4)
    meshes = MeshSequence(deform_all(body, poses), body.faces, 30.0)
    height = lowest(body, poses) + 0.03
    floor = FeetOnFloor(jnp.arange(len(body.vertices)), jnp.asarray(height))
    options = {"skeleton": body.skeleton, "symmetry": False, "rounds": 1, "alpha": 1.0}
    free = learn_body(meshes, **options)
    raised = learn_body(meshes, **options, terms=1e4 * floor)
    assert lowest(free.body, free.motion.poses) < height - 0.02
    assert lowest(raised.body, raised.motion.poses) > height - 0.01
    values = [q for _, q in raised.history]
    assert all(b <= a for a, b in zip(values, values[1:], strict=False))
    with pytest.raises(InputError, match="FeetOnFloor"):
        learn_body(meshes, **options, terms=[FeetOnFloor(jnp.array([10**6]), jnp.asarray(0.0))])


def test_a_term_moves_joints_by_their_derivative(rng):
    body, poses = arm(rng, 4)
    targets = deform_all(body, poses)
    metric = make_conformance(np.asarray(body.faces), len(body.vertices), 1.0)
    place = jc.pose_body(body, jax.tree.map(lambda leaf: leaf[0], poses)).joints[2]
    term = 1e-2 * Hand(place)
    value, damping = float(objective(body, poses, targets, metric, term)), 1e-3
    first = value
    for _ in range(4):
        body, poses, value, damping = improve_joints(
            body, poses, targets, metric, make_curvature(metric), NONE, damping, value, terms=term
        )
    np.testing.assert_allclose(value, float(objective(body, poses, targets, metric, term)), rtol=1e-9)
    assert value < 0.9 * first
    slope = jax.grad(
        lambda centres: objective(
            eqx.tree_at(lambda b: b.skeleton.centres, body, centres), poses, targets, metric, term
        )
    )(body.skeleton.centres)
    assert float(jnp.abs(slope[1:]).max()) < 1e-2 * first
