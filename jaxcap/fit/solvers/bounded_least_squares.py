"""Least squares within bounds: violating unknowns are fixed at their bound and the rest is solved again
(Adaptation, 4.1.4).
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, PyTree

from ..linear_solvers.dense import DenseMatrix
from ..linear_solvers.structured import AbstractStructuredMatrix
from .equalities import Equalities

#: largest number of rounds
MAX_ROUNDS = 12
#: rounds in which unknowns may leave a bound again; afterwards they only accumulate there, which terminates
RELEASE_ROUNDS = 8
#: a slope counts if it exceeds this many roundings of its largest terms
ROUNDINGS = 16


class _ActiveSet(NamedTuple):
    """The active bounds: -1 at the lower bound, 1 at the upper, 0 free."""

    #: in the finished round, and in the next
    current: PyTree[Int[Array, "..."]]
    next: PyTree[Int[Array, "..."]]
    count: Int[Array, ""]
    converged: Bool[Array, ""]


def solve_bounded(
    matrix: Float[Array, "D D"] | AbstractStructuredMatrix,
    rhs: PyTree[Array],
    low: PyTree[Array],
    high: PyTree[Array],
    equalities: Equalities | None = None,
) -> PyTree[Array]:
    """Minimise `x^T A x / 2 - b^T x` subject to `low <= x <= high`, with `A` positive definite.

    For normal equations `A = J^T J` and `b = J^T r`. Except for a structured matrix, all arguments are
    pytrees like the unknowns.

    Solve the system, fix unknowns that violate a bound there, remove their rows and columns from `A`, and
    subtract their contribution from `b` (Adaptation, 4.1.4). The thesis does this once. Here an unknown whose
    slope points inwards is released again, because two unknowns fixed together may be one too many. The
    rounds go on until nothing changes; then the solution is exact. A few rounds suffice. After `RELEASE_ROUNDS`
    rounds nothing is released, and the solution is within its bounds in any case.

    With `equalities` on the shared unknowns, which then have no bounds, the minimum is subject to them.

    Bounds may be infinite; if all of them are, the first round is the last. Differentiable by all arguments:
    the set of fixed unknowns is treated as constant, and only the last solution is differentiated.
    """
    system = matrix if isinstance(matrix, AbstractStructuredMatrix) else DenseMatrix(matrix)
    low, high = (jax.tree.map(lambda end, b: end.astype(b.dtype), ends, rhs) for ends in (low, high))
    at = _find_active_set(*jax.lax.stop_gradient((system, rhs, low, high, equalities)))
    return jax.tree.map(jnp.clip, _solve_free(system, rhs, at, low, high, equalities), low, high)


def _find_active_set(
    system: AbstractStructuredMatrix, rhs: PyTree, low: PyTree, high: PyTree, equalities: Equalities | None
) -> PyTree:
    def going_on(state: _ActiveSet) -> Bool[Array, ""]:
        return ~state.converged & (state.count < MAX_ROUNDS)

    def once(state: _ActiveSet) -> _ActiveSet:
        step = _solve_free(system, rhs, state.next, low, high, equalities)
        inwards = _find_releasable(system, rhs, step, state.next)

        def fix(at, x, least, most, inward):
            after = jnp.where(x < least, -1, jnp.where(x > most, 1, at))
            return jnp.where(inward & (least < most) & (state.count < RELEASE_ROUNDS), 0, after)

        after = jax.tree.map(fix, state.next, step, low, high, inwards)
        same = jax.tree.map(lambda a, b: jnp.all(a == b), after, state.next)
        return _ActiveSet(state.next, after, state.count + 1, jnp.stack(jax.tree.leaves(same)).all())

    nothing = jax.tree.map(lambda b: jnp.zeros_like(b, jnp.int32), rhs)
    start = _ActiveSet(nothing, nothing, jnp.zeros((), jnp.int32), jnp.zeros((), bool))
    return jax.lax.while_loop(going_on, once, start).current


def _solve_free(
    system: AbstractStructuredMatrix,
    rhs: PyTree,
    active: PyTree,
    low: PyTree,
    high: PyTree,
    equalities: Equalities | None,
) -> PyTree:
    """Solve for the free unknowns, with the fixed ones at their bound."""
    free = jax.tree.map(lambda a: a == 0, active)
    fixed = jax.tree.map(
        lambda a, least, most: jnp.where(a == 0, 0.0, jnp.where(a < 0, least, most)), active, low, high
    )
    known = jax.tree.map(lambda f, b, a: jnp.where(f, b - a, 0.0), free, rhs, system.mv(fixed))
    left = system.restricted(free)
    found = left.solve(known) if equalities is None else left.factorise().solve(known, equalities)
    return jax.tree.map(jnp.where, free, found, fixed)


def _find_releasable(system: AbstractStructuredMatrix, rhs: PyTree, step: PyTree, active: PyTree) -> PyTree:
    """Find the fixed unknowns that would lower the objective by moving inwards from their bound."""
    largest = system.abs_mv(jax.tree.map(jnp.abs, step))

    def points_inwards(image, b, size, a):
        return a * (image - b) > ROUNDINGS * jnp.finfo(b.dtype).eps * (size + jnp.abs(b))

    return jax.tree.map(points_inwards, system.mv(step), rhs, largest, active)
