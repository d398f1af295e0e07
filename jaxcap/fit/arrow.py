"""Least squares of many frames that share some unknowns: block-arrow normal equations.

Every frame has its own unknowns `x_m`, all frames share `s`; frames meet only through `s`. The
normal equations

    [ A_1           B_1 ] [x_1]   [g_1]
    [      A_2      B_2 ] [x_2] = [g_2]
    [ B_1^T  B_2^T  C   ] [ s ]   [ h ]

are solved by the Schur complement of the frames, `C - sum_m B_m^T A_m^-1 B_m`: the cost grows
with the number of frames, not with its cube.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.scipy.linalg
from jaxtyping import Array, Float


class Arrow(eqx.Module):
    """Block-arrow normal equations `J^T J` and a right-hand side `J^T r` of F frames."""

    frames: Float[Array, "F D D"]
    coupling: Float[Array, "F D S"]
    shared: Float[Array, "S S"]
    frame_side: Float[Array, "F D"]
    shared_side: Float[Array, "S"]


def damped(arrow: Arrow, damping: Float[Array, ""]) -> Arrow:
    """Marquardt's damping: every diagonal grows by the share `damping`, and no diagonal is
    left far below the largest of its own block, so that unknowns without data stay still."""
    floor = jnp.finfo(arrow.shared.dtype).eps
    return Arrow(
        jax.vmap(_raise_diagonal, (0, None, None))(arrow.frames, damping, floor),
        arrow.coupling,
        _raise_diagonal(arrow.shared, damping, floor),
        arrow.frame_side,
        arrow.shared_side,
    )


def solve_arrow(
    arrow: Arrow, constraints: Float[Array, "C S"], violation: Float[Array, "C"]
) -> tuple[Float[Array, "F D"], Float[Array, "S"]]:
    """The unknowns `(x (F, D), s (S,))` of positive definite equations, with `constraints s =
    violation` kept exactly; C may be zero.

    One Cholesky factor a frame, one frame after the other: batches of small factors stall on a CPU.
    """

    def eliminate(block):
        frame, coupling, side = block
        columns = jnp.concatenate([coupling, side[:, None]], 1)
        solved = jax.scipy.linalg.cho_solve(jax.scipy.linalg.cho_factor(frame, lower=True), columns)
        return solved, coupling.T @ solved

    solved, sums = jax.lax.map(eliminate, (arrow.frames, arrow.coupling, arrow.frame_side))
    total = jnp.sum(sums, 0)
    schur = arrow.shared - total[:, :-1]
    side = arrow.shared_side - total[:, -1]
    shared = _constrained(schur, side, constraints, violation)
    return solved[:, :, -1] - solved[:, :, :-1] @ shared, shared


def _constrained(matrix, side, constraints, violation) -> Float[Array, "S"]:
    """`argmin s^T M s / 2 - side^T s` with `constraints s = violation`, by the null space of
    the constraints' own Schur complement."""
    if matrix.shape[0] == 0:
        return side
    # equilibrated: metres and radians, and unknowns that hardly count, on one scale
    scale = 1.0 / jnp.sqrt(jnp.maximum(jnp.diag(matrix), jnp.finfo(matrix.dtype).tiny))
    even = matrix * scale[:, None] * scale[None, :]
    ridge = len(even) * jnp.finfo(even.dtype).eps
    factor = jax.scipy.linalg.cho_factor(even + ridge * jnp.eye(len(even), dtype=even.dtype), lower=True)
    free = jax.scipy.linalg.cho_solve(factor, scale * side)
    if constraints.shape[0] == 0:
        return scale * free
    rows = constraints * scale[None, :]
    answers = jax.scipy.linalg.cho_solve(factor, rows.T)
    multipliers = jnp.linalg.lstsq(rows @ answers, rows @ free - violation)[0]
    return scale * (free - answers @ multipliers)


def _raise_diagonal(matrix, damping, floor):
    if matrix.shape[0] == 0:
        return matrix
    diagonal = jnp.diag(matrix)
    least = jnp.maximum(jnp.max(diagonal) * floor, jnp.finfo(matrix.dtype).tiny)
    return matrix + jnp.diag(damping * diagonal + least)
