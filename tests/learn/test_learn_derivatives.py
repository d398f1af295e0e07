"""Derivatives of learned joints and poses against central differences."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
import pytest

import jaxcap as jc
from jaxcap.body.body import posed_vertices
from jaxcap.geometry.laplacian import make_conformance
from jaxcap.learn.skeleton.joints import JointProblem, make_curvature
from jaxcap.learn.skeleton.solve_joints import solve_joints
from tests.learn.test_learn_projection import arm


def test_joints_and_poses_by_targets_weights_and_rest_vertices(rng):
    body, poses = arm(rng, 5)
    targets = posed_vertices(body, poses) + 1e-3 * rng.normal(size=(5, len(body.vertices), 3))
    metric = make_conformance(np.asarray(body.faces), len(body.vertices), 1.0)
    curvature = make_curvature(metric)
    pick = [jnp.asarray(rng.normal(size=shape)) for shape in ((3, 3), (5, 3, 4))]

    @eqx.filter_jit
    def told(targets, weights, rest):
        there = eqx.tree_at(lambda b: (b.skin, b.vertices), body, (jc.LinearSkin(weights), rest))
        found = solve_joints(JointProblem(there, targets, metric, curvature), poses)
        turns = jnp.abs(found.poses.rotations)
        return jnp.vdot(pick[0], found.body.skeleton.centres) + jnp.vdot(pick[1], turns), found.result

    given = targets, body.skin.weights, body.vertices
    assert told(*given)[1] == optx.RESULTS.successful
    slopes = jax.grad(lambda *given: told(*given)[0], (0, 1, 2))(*given)
    for number, slope in enumerate(slopes):
        direction = jnp.asarray(rng.normal(size=slope.shape))

        def at(share, number=number, direction=direction):
            moved = [x + share * direction if i == number else x for i, x in enumerate(given)]
            return float(told(*moved)[0])

        # the solutions have rounding errors of 1e-9; differences are without the error of the second order
        step = 3e-4
        differences = (8 * (at(step) - at(-step)) - (at(2 * step) - at(-2 * step))) / (12 * step)
        np.testing.assert_allclose(jnp.vdot(slope, direction), differences, rtol=1e-5)


def test_what_cannot_be_solved_is_a_sentence(rng):
    body, poses = arm(rng, 5)
    targets = posed_vertices(body, poses)
    for wrong, word in (
        (lambda: jc.learn.make_joint_problem(body, targets[:, 1:]), "vertices; expected the"),
        (lambda: jc.learn.make_joint_problem(body, targets.at[0, 0].set(jnp.nan)), "not finite"),
        (
            lambda: solve_joints(jc.learn.make_joint_problem(body, targets[:3]), poses),
            "5 poses; expected one for each of 3",
        ),
        (
            lambda: solve_joints(jc.learn.make_joint_problem(body, targets), poses, max_steps=0),
            "`max_steps` is 0",
        ),
    ):
        with pytest.raises(jc.InputError, match=word):
            wrong()
