"""Many small positive definite systems at once, with the batch last: each step is then one long loop over it."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float


def gauss_jordan_solve(matrix: Float[Array, "K K N"], sides: Float[Array, "K S N"]) -> Float[Array, "K S N"]:
    """Solve N positive definite systems by Gauss-Jordan elimination, which needs no pivoting there.

    Pivots are raised to at least one rounding error of the diagonal; in a nearly singular system they may be zero or negative by
    rounding.
    """
    least = jnp.finfo(matrix.dtype).eps * jnp.einsum("iin->in", matrix)

    def column(i, table):
        row = table[i] / jnp.maximum(table[i, i], least[i])
        rest = table - table[:, i][:, None] * row
        return rest.at[i].set(row)

    count = matrix.shape[0]
    table = jnp.concatenate([matrix, sides], 1)
    return jax.lax.fori_loop(0, count, column, table)[:, count:]
