"""Calibration as one problem: equations against autodiff of all residuals, and derivatives of its minimum against differences."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.flatten_util import ravel_pytree

from jaxcap.energy.energy import AbstractEnergy
from jaxcap.markers.calibration.calibration_problem import (
    RIDGE,
    CalibrationEstimate,
    apply_sliding,
    make_calibration_problem,
)
from jaxcap.markers.calibration.rotation_prior import estimate_rotation_prior
from jaxcap.markers.calibration.solve_calibration import solve_calibration
from jaxcap.markers.robust import UNBOUNDED
from jaxcap.markers.subject import marker_positions
from tests.markers_limb import moving, seen_by, truth, wrong

JOINTS, FRAMES = (1, 2, 3, 4), 5


class Above(AbstractEnergy):
    """Markers and a joint near a height."""

    height: jax.Array

    def residual(self, posed):
        return 20.0 * jnp.append(posed.vertices[:3, 1], posed.joints[2, 1]) - self.height


def scene(rng, models=None, terms=()):
    """A problem with everything in it, at a point away from its minimum."""
    subject = truth()
    if models is not None:
        subject = dataclasses.replace(subject, models=models)
    motion = moving(rng, FRAMES)
    frames = seen_by(subject, motion, rng, 0.003)
    seen = np.array(frames.visible)
    seen[1, 3] = False
    problem = make_calibration_problem(
        wrong(subject, rng), jnp.asarray(frames.positions), jnp.asarray(seen), JOINTS, ((2, 4),), terms=terms
    )
    dofs = subject.skeleton.num_dofs
    spread = rng.normal(size=(FRAMES, dofs, dofs))
    turning = estimate_rotation_prior(
        subject.skeleton, motion.poses, jnp.asarray(1e-2 * spread @ np.swapaxes(spread, 1, 2))
    )
    features = jnp.asarray(rng.normal(size=(FRAMES, subject.num_markers, 2)))
    problem = eqx.tree_at(
        lambda p: (p.rotation_prior, p.skin_features, p.slide_deviations),
        problem,
        (turning, features, jnp.linspace(0.01, 0.03, 2 * subject.num_markers).reshape(2, -1)),
    )
    estimate = CalibrationEstimate(
        motion.poses,
        0.01 * jnp.asarray(rng.normal(size=len(problem.prior))),
        0.005 * jnp.asarray(rng.normal(size=(2, subject.num_markers, 3))),
    )
    return problem, estimate


@pytest.mark.parametrize("kind", ["rigid", "mixed"])
def test_equations_are_those_of_all_residuals(rng, kind):
    models = None if kind == "rigid" else tuple(("rigid", "circle", "sphere")[i % 3] for i in range(18))
    problem, y = scene(rng, models, (Above(jnp.asarray(1.0)),))
    zero = jax.tree.map(jnp.zeros_like, problem.scales())
    along = lambda p: lambda d: p.value(p.retract(y, d))  # noqa: E731
    value, gradient, hessian = eqx.filter_jit(lambda p, y: p.normal_equations(y))(problem, y)
    slope = eqx.filter_jit(lambda p: jax.grad(along(p))(zero))(problem)
    np.testing.assert_allclose(value, problem.value(y), rtol=1e-12)
    for ours, theirs in zip(gradient, slope, strict=True):
        np.testing.assert_allclose(ours, theirs, atol=1e-9 * float(jnp.abs(theirs).max()))
    # without a bound, and with residuals of zero, the second derivatives are those of Gauss-Newton
    assert hessian.coupling.shape[:2] == y.poses.rotations.shape[:1] + (problem.template.skeleton.num_dofs,)
    side = problem.pose_equations(y)
    np.testing.assert_allclose(side[0], hessian.frames.blocks[:, 0], rtol=1e-9, atol=1e-6)
    np.testing.assert_allclose(side[1], gradient[0], rtol=1e-9, atol=1e-6)


def test_the_hessian_is_that_of_a_problem_without_residuals(rng):
    """At a point that explains every place exactly, Gauss-Newton's matrix is the Hessian."""
    problem, y = scene(rng)
    subject = problem.subject(y)
    place = lambda pose, phi: marker_positions(apply_sliding(subject, y.slides, phi), pose)  # noqa: E731
    places = jax.vmap(place)(y.poses, problem.skin_features)
    exact = eqx.tree_at(lambda p: (p.positions, p.outlier_bound), problem, (places, jnp.asarray(UNBOUNDED)))
    free = eqx.tree_at(lambda p: p.rotation_prior.roots, exact, jnp.zeros_like(exact.rotation_prior.roots))
    zero = jax.tree.map(jnp.zeros_like, free.scales())
    arrow = free.normal_equations(y)[2].as_matrix()
    flat, back = ravel_pytree(zero)
    dense = jax.jit(jax.hessian(lambda d: free.value(free.retract(y, back(d)))))(flat)
    count = zero[0].size
    ridge = np.append(np.full(count, RIDGE), np.zeros(len(flat) - count))
    np.testing.assert_allclose(arrow - np.diag(ridge), dense, atol=1e-8 * float(jnp.abs(dense).max()))


def test_derivatives_of_a_calibration_are_differences(rng):
    """By a place that was seen, by a marker's deviation and by the template."""
    problem, y = scene(rng)
    solve = eqx.filter_jit(solve_calibration)
    start = solve(problem, y)
    assert bool(start.trustworthy)

    def length(problem, start):
        centres = solve_calibration(problem, start).subject.skeleton.centres
        return jnp.linalg.norm(centres[2] - centres[1])

    slope = eqx.filter_jit(eqx.filter_grad(length))(problem, start.estimate)
    value = eqx.filter_jit(length)
    # differences of fits that end within their tolerance: shorter steps show its noise
    for where, index, step in (
        (lambda p: p.positions, (2, 4, 0), 1e-4),
        (lambda p: p.deviations, (5,), 3e-5),
        (lambda p: p.template.offsets, (4, 1), 1e-4),
    ):
        ends = [
            value(eqx.tree_at(where, problem, where(problem).at[index].add(sign * step)), start.estimate)
            for sign in (1, -1)
        ]
        difference = float(ends[0] - ends[1]) / (2 * step)
        assert float(where(slope)[index]) == pytest.approx(difference, rel=1e-5, abs=1e-7)


def test_a_term_moves_a_calibration(rng):
    plain, y = scene(rng)
    pulled = eqx.tree_at(lambda p: p.terms, plain, Above(jnp.asarray(22.0)), is_leaf=lambda x: x is None)
    solve = eqx.filter_jit(solve_calibration)
    height = lambda found: jax.vmap(lambda p: marker_positions(found.subject, p))(found.poses)[:, :3, 1]  # noqa: E731
    before, after = height(solve(plain, y)), height(solve(pulled, y))
    assert float(jnp.abs(after - 1.1).mean()) < float(jnp.abs(before - 1.1).mean()) - 1e-4
