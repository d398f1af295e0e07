"""Cholesky factors of equations that are first scaled to a unit diagonal."""

import equinox as eqx
import jax.numpy as jnp
from jax.scipy.linalg import solve_triangular
from jaxtyping import Array, Float


class CholeskyFactor(eqx.Module):
    """A factor `L` of `S A S = L L^T`, with diagonal `S`, so that metres and radians have one scale."""

    lower: Float[Array, "N N"]
    scale: Float[Array, "N"]

    def solve(self, rhs: Float[Array, "N *K"]) -> Float[Array, "N *K"]:
        """Solve `A x = rhs`; NaN where `A` is not positive definite."""
        if rhs.shape[0] == 0:
            return rhs
        scale = self.scale.reshape(-1, *[1] * (rhs.ndim - 1))
        half = solve_triangular(self.lower, scale * rhs, lower=True)
        return scale * solve_triangular(self.lower, half, lower=True, trans=1)


def factorise(matrix: Float[Array, "N N"], ridge: float | None = None) -> CholeskyFactor:
    """Factorise a symmetric matrix, with `ridge` or a bound of the rounding error added to its unit diagonal.

    A row of zeros has the scale one, so that an unknown without data does not move. Only the lower triangle is read. Derivatives are
    right along symmetric changes of the matrix; the gradient with respect to the matrix itself is not symmetric.
    """
    size, dtype = len(matrix), matrix.dtype
    scale = diagonal_scale(jnp.diagonal(matrix))
    if size == 0:
        return CholeskyFactor(matrix, scale)
    even = matrix * scale[:, None] * scale
    ridge = rounding_bound(size, dtype) if ridge is None else ridge
    damped = even + ridge * jnp.eye(size, dtype=dtype)
    # symmetric but for roundings; the mean with its transpose would take a fourth of the time of a small factor
    return CholeskyFactor(jnp.linalg.cholesky(damped, symmetrize_input=False), scale)


def diagonal_scale(diagonal: Float[Array, "*N"]) -> Float[Array, "*N"]:
    """Compute the scale that makes a diagonal one; one where the diagonal is not positive."""
    positive = diagonal > 0
    return jnp.where(positive, 1.0 / jnp.sqrt(jnp.where(positive, diagonal, 1.0)), 1.0)


def rounding_bound(size: int, dtype) -> float:
    """Bound the rounding error of a unit diagonal of `size` equations."""
    return max(size, 10) * float(jnp.finfo(dtype).eps)
