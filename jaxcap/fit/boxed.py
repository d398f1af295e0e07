"""Least squares within bounds: what violates its bound is fixed there, and the rest is solved again
(Adaptation, 4.1.4)."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

#: how often at most the rest is solved
ROUNDS = 12
#: rounds in which numbers at a bound may leave it again; afterwards they only gather there, which ends
RELEASES = 8
#: a slope counts from so many roundings of what it is the sum of
ROUNDINGS = 16


class _Round(NamedTuple):
    """A solution, and which numbers are fixed for the next: -1 at the lower bound, 1 at the upper, 0 free."""

    step: Float[Array, "D"]
    at: Int[Array, "D"]
    count: Int[Array, ""]
    settled: Bool[Array, ""]


def solve_boxed(
    matrix: Float[Array, "D D"], side: Float[Array, "D"], low: Float[Array, "D"], high: Float[Array, "D"]
) -> Float[Array, "D"]:
    """The `x` in `[low, high]` that makes `x^T A x / 2 - b^T x` least, with `A` positive definite; for normal
    equations `A = J^T J` and `b = J^T r`.

    The system is solved; what violates a bound is fixed there; rows and columns of the fixed are taken
    out of `A`, and `b` is less what they account for (Adaptation, 4.1.4). The thesis does it once. As two numbers
    that are fixed together may be one too many, a fixed one that the slope draws inwards is let go, and
    it goes on until nothing changes. Then the solution is exact; a few rounds do. Where it has not come
    to rest after `RELEASES` rounds nothing is let go any more, and the solution is within its bounds all the same.

    Bounds may be infinite. With all of them infinite it is one Cholesky decomposition.
    """
    low, high = low.astype(matrix.dtype), high.astype(matrix.dtype)

    def going_on(state: _Round) -> Bool[Array, ""]:
        return ~state.settled & (state.count < ROUNDS)

    def once(state: _Round) -> _Round:
        step = _solve_free(matrix, side, state.at, jnp.where(state.at < 0, low, high))
        at = jnp.where(step < low, -1, jnp.where(step > high, 1, state.at))
        inwards = _drawn_inwards(matrix, side, step, state.at) & (low < high)
        at = jnp.where(inwards & (state.count < RELEASES), 0, at)
        return _Round(step, at, state.count + 1, jnp.all(at == state.at))

    nothing = jnp.zeros_like(side, jnp.int32)
    start = _Round(jnp.zeros_like(side), nothing, jnp.zeros((), jnp.int32), jnp.zeros((), bool))
    return jnp.clip(jax.lax.while_loop(going_on, once, start).step, low, high)


def _solve_free(
    matrix: Float[Array, "D D"], side: Float[Array, "D"], at: Int[Array, "D"], bound: Float[Array, "D"]
) -> Float[Array, "D"]:
    """The free numbers by what is left of the system, the fixed ones at their bound. Rows and columns
    are masked, not removed, so that shapes stay."""
    free = at == 0
    fixed = jnp.where(free, 0.0, bound)
    left = jnp.where(free[:, None] & free, matrix, 0.0) + jnp.diag(jnp.where(free, 0.0, 1.0))
    known = jnp.matmul(matrix, fixed, precision="highest")
    solved = jax.scipy.linalg.solve(left, jnp.where(free, side - known, fixed), assume_a="pos")
    return jnp.where(free, solved, fixed)


def _drawn_inwards(
    matrix: Float[Array, "D D"], side: Float[Array, "D"], step: Float[Array, "D"], at: Int[Array, "D"]
) -> Bool[Array, "D"]:
    """Which of the fixed numbers would make the sum less by leaving their bound inwards."""
    slope = jnp.matmul(matrix, step, precision="highest") - side
    noise = ROUNDINGS * jnp.finfo(side.dtype).eps * (jnp.abs(matrix) @ jnp.abs(step) + jnp.abs(side))
    return at * slope > noise
