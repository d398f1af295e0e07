"""Minima that are differentiable by all arrays of their problem, with the same structured factors."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import optimistix as optx
from jaxtyping import Array, Bool, Float

from ..linear_solvers.conjugate_gradients import conjugate_gradients
from ..linear_solvers.structured import damped
from .descent import ConstrainedInfo
from .equalities import Equalities
from .least_squares_problem import AbstractProblem
from .minimise import AnySolver, Minimum, minimise

#: of the conjugate gradients for a derivative: largest number of steps, relative residual at the end, and its
#: lower limit in roundings
DERIVATIVE_STEPS, DERIVATIVE_TOLERANCE, DERIVATIVE_ROUNDINGS = 200, 1e-12, 10
#: the share of each curvature added to it, as a power of the precision
RIDGE_EXPONENT = 0.7
#: the largest share of the energy that a Newton step may still gain at a solution with a trusted derivative
MAX_RELATIVE_GAIN = 1e-6


def implicit_minimum(
    problem: AbstractProblem,
    start: Any,
    solver: AnySolver,
    max_steps: int,
    project: Callable[[Any, Any], Any] | None = None,
) -> Minimum:
    """Minimise a problem, with derivatives by every array of it (`jax.grad`, `jax.jvp`), not by the start.

    **Arguments:** as of `minimise`; `project(problem, y)` projects `y` onto the manifold, for the case that
    parameters of the manifold, such as joint axes, are themselves differentiated.
    """
    y, rest = _minimum(problem, start, solver, max_steps, project)
    return eqx.tree_at(lambda m: m.y, rest, y, is_leaf=lambda x: x is None)


@eqx.filter_jit
def energy_at(problem: AbstractProblem, y: Any) -> Float[Array, ""]:
    """Compute `|r|^2` at `y`."""
    return 2.0 * problem.value(y)


@eqx.filter_jit
def is_trustworthy(problem: AbstractProblem, found: Minimum) -> Bool[Array, ""]:
    """Test if derivatives by the implicit function theorem hold at a minimum.

    The solver has converged, and a Newton step within the constraints would gain only a small share of the
    energy.
    """
    arrays, rest = eqx.partition((problem, found.y), eqx.is_array)
    info = _information(*eqx.combine(jax.lax.stop_gradient(arrays), rest))
    inside = _constrained_system(info)
    left, value = 0.5 * _dot(info.grad, inside.solve(info.grad)), info.as_min()
    small = left <= MAX_RELATIVE_GAIN * value + jnp.finfo(value.dtype).eps ** 1.5
    return small & _is_feasible(info) & (found.result == optx.RESULTS.successful)


def _is_feasible(info: ConstrainedInfo) -> Bool[Array, ""]:
    """Test if a point is within its bounds, up to rounding."""
    constraints = info.constraints
    if constraints is None or constraints.low is None:
        return jnp.array(True)
    kept = jax.tree.map(
        lambda low, high: jnp.all((low <= _bound_tolerance(low)) & (high >= -_bound_tolerance(high))),
        constraints.low,
        constraints.high,
    )
    return jnp.stack(jax.tree.leaves(kept)).all()


def _bound_tolerance(end: Float[Array, "..."]) -> float:
    """Compute the distance from a bound within which an unknown counts as at the bound."""
    return 1e3 * float(jnp.finfo(end.dtype).eps)


class _ConstrainedSystem(eqx.Module):
    """Equations within constraints: unknowns pressed against a bound stay, and steps satisfy linear
    equalities.
    """

    factor: Any
    #: the amount added to the diagonal of the factor, so that rounding moves little along undetermined
    #: directions
    ridge: Any
    free: Any
    rows: Float[Array, "C S"] | None

    def project(self, x: Any) -> Any:
        """Project a gradient onto the constraints."""
        x = jax.tree.map(lambda free, leaf: jnp.where(free, leaf, 0.0), self.free, x)
        if self.rows is None:
            return x
        leaves, structure = jax.tree.flatten(x)
        # equalities concern the shared unknowns, the last leaf
        leaves[-1] = leaves[-1] - self.rows.T @ jnp.linalg.lstsq(self.rows.T, leaves[-1])[0]
        return jax.tree.unflatten(structure, leaves)

    def solve(self, rhs: Any, values: Float[Array, "C"] | None = None) -> Any:
        """Minimise `x^T A x / 2 - rhs^T x` over the free unknowns subject to `rows x = values`, zero if not
        given.
        """
        if self.rows is None:
            return self.project(self.factor.solve(self.project(rhs)))
        values = jnp.zeros(len(self.rows), self.rows.dtype) if values is None else values
        return self.factor.solve(self.project(rhs), Equalities(self.rows, values))


def _constrained_system(info: ConstrainedInfo) -> _ConstrainedSystem:
    hessian: Any = info.hessian
    constraints, free = info.constraints, free_unknowns(info)
    equalities = None if constraints is None else constraints.equalities
    if constraints is not None and constraints.low is not None:
        hessian = hessian.restricted(free)
    dtype = info.as_min().dtype
    damped_hessian = damped(hessian, jnp.asarray(jnp.finfo(dtype).eps ** RIDGE_EXPONENT, dtype))
    little = jax.tree.map(jnp.subtract, damped_hessian.diagonal(), hessian.diagonal())
    return _ConstrainedSystem(
        damped_hessian.factorise(), little, free, None if equalities is None else equalities.rows
    )


def free_unknowns(info: ConstrainedInfo) -> Any:
    """Find the unknowns that are not pressed against a bound."""
    constraints = info.constraints
    if constraints is None or constraints.low is None:
        return jax.tree.map(lambda leaf: jnp.ones(leaf.shape, bool), info.grad)

    def is_free(low, high, slope):
        room = _bound_tolerance(slope)
        return ~((low >= -room) & (slope > 0)) & ~((high <= room) & (slope < 0)) & (low < high)

    return jax.tree.map(is_free, constraints.low, constraints.high, info.grad)


def _dot(a: Any, b: Any) -> Float[Array, ""]:
    return jax.tree.reduce(jnp.add, jax.tree.map(jnp.vdot, a, b))


@eqx.filter_jit
@jax.default_matmul_precision("highest")
def _information(problem: AbstractProblem, y: Any):
    return problem.information(y)


@eqx.filter_custom_jvp
def _minimum(problem, start, solver, max_steps, onto):
    return _minimise(problem, start, solver, max_steps)


@eqx.filter_jit
def _minimise(problem, start, solver, max_steps):
    found = minimise(problem, start, solver, max_steps)
    return found.y, eqx.tree_at(lambda m: m.y, found, None)


@_minimum.def_jvp
def _minimum_jvp(primals, tangents):
    """Differentiate a minimum by the implicit function theorem.

    The gradient `g(d; p)` of the Lagrangian by the tangent vanishes there for every value of the parameters
    `p`, so that `d' = -(dg/dd)^-1 (dg/dp) p'`, with the whole Hessian. Conjugate gradients solve it by
    products, with the factor of the Gauss-Newton equations as preconditioner. Undetermined directions have no
    part in it; where no such derivative exists, it is NaN. Equalities stay satisfied to first order, and
    gradients are projected onto their null space (Gould, Hribar and Nocedal 2001).
    """
    problem, start, solver, max_steps, onto = primals
    y, rest = _minimum(problem, start, solver, max_steps, onto)
    scales = problem.scales()
    zero = jax.tree.map(jnp.zeros_like, scales)
    info = _information(problem, y)
    inside = _constrained_system(info)
    forces = None if inside.rows is None else _multipliers(info, inside.rows)

    def moved(problem, d):
        return problem.retract(y if onto is None else onto(problem, y), jax.tree.map(jnp.multiply, scales, d))

    def violation(problem, d):
        return -problem.information(moved(problem, d)).constraints.equalities.values

    def lagrangian(problem, d):
        value = problem.value(moved(problem, d))
        return value if forces is None else value + forces @ violation(problem, d)

    def gradient(problem, d):
        return jax.grad(lambda d: lagrangian(problem, d))(d)

    def of_parameters(function, none):
        _, change = eqx.filter_jvp(lambda p: function(p, zero), (problem,), (tangents[0],))
        # JAX returns None for a result that does not depend on the parameters
        return jax.tree.map(lambda none, part: none if part is None else part, none, change, is_leaf=_is_none)

    def curvature(d):
        bent = jax.jvp(lambda d: gradient(problem, d), (zero,), (d,))[1]
        return inside.project(jax.tree.map(lambda b, a, d: b + a * d, bent, inside.ridge, d))

    side, first = jax.tree.map(jnp.negative, of_parameters(gradient, zero)), zero
    if inside.rows is not None:
        # the step that follows the equalities as they change, and then the remaining step in their null space
        first = inside.solve(zero, -of_parameters(violation, jnp.zeros(len(inside.rows), inside.rows.dtype)))
        side = jax.tree.map(jnp.subtract, side, curvature(first))
    eps = float(jnp.finfo(info.as_min().dtype).eps)
    step = conjugate_gradients(
        curvature,
        inside.project(side),
        inside.solve,
        tolerance=max(DERIVATIVE_TOLERANCE, DERIVATIVE_ROUNDINGS * eps),
        max_steps=DERIVATIVE_STEPS,
        project=inside.project,
        unsolved=eps**0.5,
    )
    step = jax.tree.map(jnp.add, first, step)
    _, tangent = eqx.filter_jvp(moved, (problem, zero), (tangents[0], step))
    return (y, rest), (tangent, jax.tree.map(lambda _: None, rest))


def _multipliers(info: ConstrainedInfo, rows: Float[Array, "C S"]) -> Float[Array, "C"]:
    """Compute the multipliers of equalities, which may be dependent, with `g + rows^T multipliers = 0`."""
    slope = info.grad[-1] if isinstance(info.grad, tuple) else info.grad
    return -jnp.linalg.lstsq(rows.T, slope)[0]


def _is_none(node: Any) -> bool:
    return node is None
