"""Minima with derivatives by what a problem is made of, by the implicit function theorem."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp

from .conjugate_gradients import conjugate_gradients
from .minimise import AnySolver, minimise
from .problem import AbstractProblem, Tangent

#: steps of conjugate gradients for a derivative at most, and the share of the right side at which they end
STEPS, TOLERANCE = 200, 1e-12
#: `moved(problem, y, d)`: along a tangent, on the manifold of that problem
Moved = Callable[[Any, Any, Tangent], Any]


@eqx.filter_custom_jvp
def minimum(
    problem: AbstractProblem, start: Any, solver: AnySolver, max_steps: int, moved: Moved
) -> tuple[Any, Any]:
    """Find a minimum, and its history, number of steps and result, as `minimise` does.

    Derivatives of the minimum by every array of the problem hold where it converged and nothing constrains its steps: at a
    minimum the gradient `g(d; p)` by the tangent vanishes for every value of the parameters `p`, so that
    `d' = -(dg/dd)^-1 (dg/dp) p'`, with the whole Hessian: conjugate gradients on its products, with the factor of the
    Gauss-Newton equations as preconditioner.
    """
    del moved
    return _descend(problem, start, solver, max_steps)


@eqx.filter_jit
def information(problem: AbstractProblem, y: Any):
    """Linearise a problem, compiled once."""
    return problem.information(y)


@eqx.filter_jit
def _descend(problem, start, solver, max_steps):
    found = minimise(problem, start, solver, max_steps)
    return found.y, (found.history, found.num_steps, found.result)


@minimum.def_jvp
def _implicit(primals, tangents):
    problem, start, solver, max_steps, moved = primals
    y, stats = minimum(problem, start, solver, max_steps, moved)
    scales = problem.scales()
    zero = jax.tree.map(jnp.zeros_like, scales)
    hessian: Any = information(problem, y).hessian
    factor = hessian.factorise()

    def gradient(p, d):
        return jax.grad(lambda d: p.value(moved(p, y, d)))(d)

    _, change = eqx.filter_jvp(lambda p: gradient(p, zero), (problem,), (tangents[0],))
    # nothing at all is known of what does not depend on the parameters
    change = tuple(none if part is None else part for part, none in zip(change, zero, strict=True))

    def curvature(d):
        return jax.jvp(lambda d: gradient(problem, d), (zero,), (d,))[1]

    def precondition(side):
        inner = factor.solve(jax.tree.map(jnp.multiply, scales, side))
        return jax.tree.map(jnp.multiply, scales, inner)

    step = conjugate_gradients(curvature, change, precondition, tolerance=TOLERANCE, max_steps=STEPS)
    step = jax.tree.map(jnp.negative, step)
    _, tangent = eqx.filter_jvp(lambda p, d: moved(p, y, d), (problem, zero), (tangents[0], step))
    return (y, stats), (tangent, jax.tree.map(lambda _: None, stats))
