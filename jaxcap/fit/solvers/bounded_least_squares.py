"""Least squares within bounds: what violates its bound is fixed there, and the rest is solved again
(Adaptation, 4.1.4)."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, PyTree

from ..linear.dense import Dense
from ..linear.structured import AbstractStructured
from .equalities import Equalities

#: how often at most the rest is solved
ROUNDS = 12
#: rounds in which numbers at a bound may leave it again; afterwards they only gather there, which ends
RELEASES = 8
#: a slope counts from so many roundings of what it is the sum of
ROUNDINGS = 16


class _Round(NamedTuple):
    """Which numbers are fixed: -1 at the lower bound, 1 at the upper, 0 free."""

    #: in the round that is done, and in the next
    at: PyTree[Int[Array, "..."]]
    after: PyTree[Int[Array, "..."]]
    count: Int[Array, ""]
    settled: Bool[Array, ""]


def solve_boxed(
    matrix: Float[Array, "D D"] | AbstractStructured,
    side: PyTree[Array],
    low: PyTree[Array],
    high: PyTree[Array],
    equalities: Equalities | None = None,
) -> PyTree[Array]:
    """The `x` in `[low, high]` that makes `x^T A x / 2 - b^T x` least, with `A` positive definite; for normal
    equations `A = J^T J` and `b = J^T r`. All but a structured matrix are pytrees like the unknowns.

    The system is solved; what violates a bound is fixed there; rows and columns of the fixed are taken
    out of `A`, and `b` is less what they account for (Adaptation, 4.1.4). The thesis does it once. As two numbers
    that are fixed together may be one too many, a fixed one that the slope draws inwards is let go, and
    it goes on until nothing changes. Then the solution is exact; a few rounds do. Where it has not come
    to rest after `RELEASES` rounds nothing is let go any more, and the solution is within its bounds all the same.

    With `equalities` of what is shared, which then has no bounds, the least among those that keep them.

    Bounds may be infinite; with all of them infinite the first round is the last. Differentiable by all arguments: those
    that are fixed are held to be the same nearby, and the last solution is differentiated alone.
    """
    system = matrix if isinstance(matrix, AbstractStructured) else Dense(matrix)
    low, high = (jax.tree.map(lambda end, b: end.astype(b.dtype), ends, side) for ends in (low, high))
    at = _find_fixed(*jax.lax.stop_gradient((system, side, low, high, equalities)))
    return jax.tree.map(jnp.clip, _solve_free(system, side, at, low, high, equalities), low, high)


def _find_fixed(
    system: AbstractStructured, side: PyTree, low: PyTree, high: PyTree, equalities: Equalities | None
) -> PyTree:
    def going_on(state: _Round) -> Bool[Array, ""]:
        return ~state.settled & (state.count < ROUNDS)

    def once(state: _Round) -> _Round:
        step = _solve_free(system, side, state.after, low, high, equalities)
        inwards = _drawn_inwards(system, side, step, state.after)

        def fix(at, x, least, most, inward):
            after = jnp.where(x < least, -1, jnp.where(x > most, 1, at))
            return jnp.where(inward & (least < most) & (state.count < RELEASES), 0, after)

        after = jax.tree.map(fix, state.after, step, low, high, inwards)
        same = jax.tree.map(lambda a, b: jnp.all(a == b), after, state.after)
        return _Round(state.after, after, state.count + 1, jnp.stack(jax.tree.leaves(same)).all())

    nothing = jax.tree.map(lambda b: jnp.zeros_like(b, jnp.int32), side)
    start = _Round(nothing, nothing, jnp.zeros((), jnp.int32), jnp.zeros((), bool))
    return jax.lax.while_loop(going_on, once, start).at


def _solve_free(
    system: AbstractStructured,
    side: PyTree,
    at: PyTree,
    low: PyTree,
    high: PyTree,
    equalities: Equalities | None,
) -> PyTree:
    """The free numbers by what is left of the system, the fixed ones at their bound."""
    free = jax.tree.map(lambda a: a == 0, at)
    fixed = jax.tree.map(
        lambda a, least, most: jnp.where(a == 0, 0.0, jnp.where(a < 0, least, most)), at, low, high
    )
    known = jax.tree.map(lambda f, b, a: jnp.where(f, b - a, 0.0), free, side, system.mv(fixed))
    left = system.among(free)
    found = left.solve(known) if equalities is None else left.factorise().solve(known, equalities)
    return jax.tree.map(jnp.where, free, found, fixed)


def _drawn_inwards(system: AbstractStructured, side: PyTree, step: PyTree, at: PyTree) -> PyTree:
    """Which of the fixed numbers would make the sum less by leaving their bound inwards."""
    largest = system.magnitudes(jax.tree.map(jnp.abs, step))

    def drawn(image, b, size, a):
        return a * (image - b) > ROUNDINGS * jnp.finfo(b.dtype).eps * (size + jnp.abs(b))

    return jax.tree.map(drawn, system.mv(step), side, largest, at)
