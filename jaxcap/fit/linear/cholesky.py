"""Cholesky factors of equations that are first brought to a unit diagonal."""

import equinox as eqx
import jax.numpy as jnp
from jax.scipy.linalg import solve_triangular
from jaxtyping import Array, Float


class CholeskyFactor(eqx.Module):
    """A factor `L` of `S A S = L L^T`, with `S` diagonal so that metres and radians are on one scale."""

    lower: Float[Array, "N N"]
    scale: Float[Array, "N"]

    def solve(self, side: Float[Array, "N *K"]) -> Float[Array, "N *K"]:
        """Solve `A x = side`; not numbers where `A` was not positive definite."""
        if side.shape[0] == 0:
            return side
        scale = self.scale.reshape(-1, *[1] * (side.ndim - 1))
        half = solve_triangular(self.lower, scale * side, lower=True)
        return scale * solve_triangular(self.lower, half, lower=True, trans=1)


def factorise(matrix: Float[Array, "N N"], ridge: float | None = None) -> CholeskyFactor:
    """Factor a symmetric matrix, given back on its unit diagonal what rounding may take, or `ridge`.

    A row of zeros gets a scale of one, so that an unknown of which nothing is told stays where it is.
    """
    size, dtype = len(matrix), matrix.dtype
    scale = unit_scale(jnp.diagonal(matrix))
    if size == 0:
        return CholeskyFactor(matrix, scale)
    even = matrix * scale[:, None] * scale
    ridge = rounding(size, dtype) if ridge is None else ridge
    return CholeskyFactor(jnp.linalg.cholesky(even + ridge * jnp.eye(size, dtype=dtype)), scale)


def unit_scale(diagonal: Float[Array, "*N"]) -> Float[Array, "*N"]:
    """Compute the scale that brings a diagonal to one; one where the diagonal is not positive."""
    positive = diagonal > 0
    return jnp.where(positive, 1.0 / jnp.sqrt(jnp.where(positive, diagonal, 1.0)), 1.0)


def rounding(size: int, dtype) -> float:
    """Bound what rounding may take from a unit diagonal of so many equations."""
    return max(size, 10) * float(jnp.finfo(dtype).eps)
