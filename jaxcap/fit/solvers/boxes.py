"""Least squares within bounds: what violates its bound is fixed there, and the rest is solved again
(Adaptation, 4.1.4)."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from .dense import Dense
from .structured import AbstractStructured

#: how often at most the rest is solved
ROUNDS = 12
#: rounds in which numbers at a bound may leave it again; afterwards they only gather there, which ends
RELEASES = 8
#: a slope counts from so many roundings of what it is the sum of
ROUNDINGS = 16


class _Round(NamedTuple):
    """Which numbers are fixed: -1 at the lower bound, 1 at the upper, 0 free."""

    #: in the round that is done, and in the next
    at: Int[Array, "*D"]
    after: Int[Array, "*D"]
    count: Int[Array, ""]
    settled: Bool[Array, ""]


def solve_boxed(
    matrix: Float[Array, "D D"] | AbstractStructured,
    side: Float[Array, "*D"],
    low: Float[Array, "*D"],
    high: Float[Array, "*D"],
) -> Float[Array, "*D"]:
    """The `x` in `[low, high]` that makes `x^T A x / 2 - b^T x` least, with `A` positive definite; for normal
    equations `A = J^T J` and `b = J^T r`.

    The system is solved; what violates a bound is fixed there; rows and columns of the fixed are taken
    out of `A`, and `b` is less what they account for (Adaptation, 4.1.4). The thesis does it once. As two numbers
    that are fixed together may be one too many, a fixed one that the slope draws inwards is let go, and
    it goes on until nothing changes. Then the solution is exact; a few rounds do. Where it has not come
    to rest after `RELEASES` rounds nothing is let go any more, and the solution is within its bounds all the same.

    Bounds may be infinite; with all of them infinite the first round is the last. Differentiable by all arguments: those
    that are fixed are held to be the same nearby, and the last solution is differentiated alone.
    """
    system = matrix if isinstance(matrix, AbstractStructured) else Dense(matrix)
    low, high = low.astype(side.dtype), high.astype(side.dtype)
    at = _find_fixed(*jax.lax.stop_gradient((system, side, low, high)))
    return jnp.clip(_solve_free(system, side, at, low, high), low, high)


def _find_fixed(
    system: AbstractStructured, side: Float[Array, "*D"], low: Float[Array, "*D"], high: Float[Array, "*D"]
) -> Int[Array, "*D"]:
    def going_on(state: _Round) -> Bool[Array, ""]:
        return ~state.settled & (state.count < ROUNDS)

    def once(state: _Round) -> _Round:
        at = state.after
        step = _solve_free(system, side, at, low, high)
        after = jnp.where(step < low, -1, jnp.where(step > high, 1, at))
        inwards = _drawn_inwards(system, side, step, at) & (low < high)
        after = jnp.where(inwards & (state.count < RELEASES), 0, after)
        return _Round(at, after, state.count + 1, jnp.all(after == at))

    nothing = jnp.zeros_like(side, jnp.int32)
    start = _Round(nothing, nothing, jnp.zeros((), jnp.int32), jnp.zeros((), bool))
    return jax.lax.while_loop(going_on, once, start).at


def _solve_free(
    system: AbstractStructured,
    side: Float[Array, "*D"],
    at: Int[Array, "*D"],
    low: Float[Array, "*D"],
    high: Float[Array, "*D"],
) -> Float[Array, "*D"]:
    """The free numbers by what is left of the system, the fixed ones at their bound."""
    free = at == 0
    fixed = jnp.where(free, 0.0, jnp.where(at < 0, low, high))
    known = jnp.where(free, side - system.mv(fixed), 0.0)
    return jnp.where(free, system.among(free).solve(known), fixed)


def _drawn_inwards(
    system: AbstractStructured, side: Float[Array, "*D"], step: Float[Array, "*D"], at: Int[Array, "*D"]
) -> Bool[Array, "*D"]:
    """Which of the fixed numbers would make the sum less by leaving their bound inwards."""
    slope = system.mv(step) - side
    noise = ROUNDINGS * jnp.finfo(side.dtype).eps * (system.magnitudes(jnp.abs(step)) + jnp.abs(side))
    return at * slope > noise
