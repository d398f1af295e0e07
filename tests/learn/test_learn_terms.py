"""An energy of a user's own moves a learned body."""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Array, Float

import jaxcap as jc
from jaxcap.body.body import posed_vertices
from jaxcap.energy.energy import sum_energies
from jaxcap.errors import InputError
from jaxcap.fit.solvers.descent import ConstrainedInfo
from jaxcap.geometry.laplacian import make_conformance
from jaxcap.learn.learn_body import learn_body
from jaxcap.learn.objective import objective
from jaxcap.learn.skeleton.joints import JointProblem, improve_joints, make_curvature
from jaxcap.observe.meshes import MeshSequence
from tests.energy.test_terms import FeetOnFloor
from tests.learn.test_learn_projection import arm
from tests.learn.test_learn_steps import NONE


class Hand(jc.AbstractEnergy):
    """How far a joint is from a place, millimetres."""

    place: Float[Array, "3"]

    def residual(self, posed: jc.body.Posed) -> Float[Array, "3"]:
        return (posed.joints[2] - self.place) / 1e-3


def lowest(body, poses) -> float:
    return float(posed_vertices(body, poses)[..., 1].min())


def test_a_floor_raises_learned_poses(rng):
    body, poses = arm(rng, 4)
    # the skeleton stands in the first mesh
    rest = jc.rest_pose(body.skeleton)
    poses = jax.tree.map(lambda leaf, still: leaf.at[0].set(still), poses, rest)
    meshes = MeshSequence(posed_vertices(body, poses), body.faces, 30.0)
    height = lowest(body, poses) + 0.03
    floor = FeetOnFloor(jnp.arange(len(body.vertices)), jnp.asarray(height))
    options = {"skeleton": body.skeleton, "symmetry": False, "rounds": 1, "alpha": 1.0}
    free = learn_body(meshes, **options)
    raised = learn_body(meshes, **options, terms=100.0 * floor)
    assert lowest(free.body, free.motion.poses) < height - 0.02
    assert lowest(raised.body, raised.motion.poses) > height - 0.01
    values = [q for _, q in raised.history]
    assert all(b <= a for a, b in itertools.pairwise(values))
    # meshes of another precision than JAX's
    rounded = MeshSequence(meshes.vertices.astype(jnp.float32), body.faces, 30.0)
    again = learn_body(rounded, **options)
    assert again.body.vertices.dtype == jnp.result_type(float)
    np.testing.assert_allclose([q for _, q in again.history], [q for _, q in free.history], rtol=1e-3)
    with pytest.raises(InputError, match="FeetOnFloor"):
        learn_body(meshes, **options, terms=[FeetOnFloor(jnp.array([10**6]), jnp.asarray(0.0))])


def checked_information(problem: JointProblem, poses: jc.Pose) -> ConstrainedInfo:
    """Return the equations of a problem at its start, whose gradient has to be that of its value."""
    y = problem.start(poses)
    zero = jax.tree.map(jnp.zeros_like, problem.scales())
    slopes = jax.grad(lambda d: problem.value(problem.retract(y, d)))(zero)
    info = problem.information(y)
    for found, slope in zip(info.grad, slopes, strict=True):
        np.testing.assert_allclose(found, slope, rtol=1e-8, atol=1e-9)
    return info


def test_equations_with_terms_are_the_gradient(rng):
    body, poses = arm(rng, 3)
    targets = posed_vertices(body, poses) + 0.01 * rng.normal(size=(3, len(body.vertices), 3))
    metric = make_conformance(np.asarray(body.faces), len(body.vertices), 1.0)
    floor = FeetOnFloor(jnp.arange(len(body.vertices)), jnp.asarray(lowest(body, poses) + 0.05))
    terms = sum_energies([1e-3 * Hand(jnp.array([0.5, 0.2, 0.1])), 1e-2 * floor])
    problem = JointProblem(body, targets, metric, make_curvature(metric), terms=terms)
    info = checked_information(problem, poses)
    alone = JointProblem(body, targets, metric, make_curvature(metric)).information(problem.start(poses))
    assert float(jnp.abs(info.grad[1] - alone.grad[1]).max()) > 0.1
    value = 2 * float(info.f)
    step = improve_joints(
        body, poses, targets, metric, make_curvature(metric), NONE, 1e-3, value, terms=terms
    )
    left = float(objective(step.body, step.poses, targets, metric, terms))
    np.testing.assert_allclose(step.value, left, rtol=1e-9)
    assert left < 0.9 * value
