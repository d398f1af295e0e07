"""Closed-form solutions of small and of sparse linear equations, in NumPy: one place for what is no iteration.

What is minimised in steps goes to the solvers of `fit/solvers`, whose factors live in JAX. Here are equations that are
solved once: stacks of small systems, the covariance of an information matrix, and a sparse factor for many right-hand
sides. Symmetric matrices are first brought to a unit diagonal, so that metres, radians and what is hardly known stand
beside each other without loss.
"""

import numpy as np
import scipy.sparse
import scipy.sparse.linalg
from jaxtyping import Float


def solve(matrix: Float[np.ndarray, "*B N N"], side: Float[np.ndarray, "*B N"]) -> Float[np.ndarray, "*B N"]:
    """Compute `x` with `A x = b` for every square `A` of a stack.

    **Raises:** `numpy.linalg.LinAlgError` where a matrix is singular to the last bit; one that is nearly so has an
    answer of rounding.
    """
    return np.linalg.solve(matrix, side[..., None])[..., 0]


def inverse(matrix: Float[np.ndarray, "*B N N"]) -> Float[np.ndarray, "*B N N"]:
    """Compute the inverse of every square matrix of a stack.

    **Raises:** `numpy.linalg.LinAlgError` where a matrix is singular to the last bit.
    """
    return np.linalg.inv(matrix)


def solve_symmetric(
    matrix: Float[np.ndarray, "*B N N"], side: Float[np.ndarray, "*B N"]
) -> Float[np.ndarray, "*B N"]:
    """Compute `x` with `A x = b` for every symmetric `A` of a stack, brought to a unit diagonal. `A` may be indefinite.

    **Raises:** `numpy.linalg.LinAlgError` where a matrix is singular to the last bit, as one with a row of zeros is.
    """
    scale = _scale(matrix)
    return scale * solve(_even(matrix, scale), scale * side)


def inverse_symmetric(matrix: Float[np.ndarray, "*B N N"]) -> Float[np.ndarray, "*B N N"]:
    """Compute the inverse of every symmetric matrix of a stack, symmetric itself: the covariance of an information
    matrix, and the other way round. It may be indefinite.

    **Raises:** `numpy.linalg.LinAlgError` where a matrix is singular to the last bit, as one with a row of zeros is.
    """
    scale = _scale(matrix)
    found = _even(inverse(_even(matrix, scale)), scale)
    return 0.5 * (found + np.swapaxes(found, -1, -2))


def factor_symmetric(matrix: Float[np.ndarray, "*B N N"]) -> Float[np.ndarray, "*B N N"]:
    """Compute the lower triangular `L` with `L L^T = A` and a positive diagonal, for every symmetric `A` of a stack. It
    reads the lower triangle only.

    **Raises:** `numpy.linalg.LinAlgError` where a matrix is not positive definite.
    """
    return np.linalg.cholesky(matrix)


def least_squares(rows: Float[np.ndarray, "R N"], side: Float[np.ndarray, "R"]) -> Float[np.ndarray, "N"]:
    """Compute the `x` with the least `|A x - b|`, and of several that with the least `|x|`: rows may be fewer than
    unknowns, or tell some of these nothing."""
    return np.linalg.lstsq(rows, side, rcond=None)[0]


def factor_sparse(matrix: scipy.sparse.sparray | scipy.sparse.spmatrix) -> scipy.sparse.linalg.SuperLU:
    """Factor a sparse symmetric positive definite matrix, its unknowns in an order that keeps the factor sparse. Its
    `solve` takes right-hand sides `(N,)` or `(N, K)`.

    **Raises:** `RuntimeError` where the matrix is singular to the last bit.
    """
    columns = scipy.sparse.csc_array(matrix)
    return scipy.sparse.linalg.splu(columns, permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True})


def _scale(matrix: Float[np.ndarray, "*B N N"]) -> Float[np.ndarray, "*B N"]:
    """What brings a diagonal to one, or minus one; one where it is zero."""
    size = np.abs(np.diagonal(matrix, axis1=-2, axis2=-1))
    return 1.0 / np.sqrt(np.where(size > 0, size, 1.0))


def _even(
    matrix: Float[np.ndarray, "*B N N"], scale: Float[np.ndarray, "*B N"]
) -> Float[np.ndarray, "*B N N"]:
    return matrix * scale[..., :, None] * scale[..., None, :]
