"""Closed-form solutions of small dense and of sparse linear equations, in NumPy.

Iterative minimisation belongs to the solvers of `fit/solvers`, whose factors are JAX arrays. This module
solves equations once: stacks of small systems, the covariance of an information matrix, and a sparse factor
for many right-hand sides. Symmetric matrices are first scaled to a unit diagonal, so that metres, radians
and weakly observed parameters mix without loss of precision.
"""

import numpy as np
import scipy.sparse
import scipy.sparse.linalg
from jaxtyping import Float


def solve_square(
    matrix: Float[np.ndarray, "*B N N"], rhs: Float[np.ndarray, "*B N"]
) -> Float[np.ndarray, "*B N"]:
    """Compute `x` with `A x = b` for every square `A` of a stack.

    **Raises:** `numpy.linalg.LinAlgError` where a matrix is exactly singular; the solution of a nearly
    singular one is dominated by rounding.
    """
    return np.linalg.solve(matrix, rhs[..., None])[..., 0]


def inverse(matrix: Float[np.ndarray, "*B N N"]) -> Float[np.ndarray, "*B N N"]:
    """Compute the inverse of every square matrix of a stack.

    **Raises:** `numpy.linalg.LinAlgError` where a matrix is exactly singular.
    """
    return np.linalg.inv(matrix)


def solve_symmetric(
    matrix: Float[np.ndarray, "*B N N"], rhs: Float[np.ndarray, "*B N"]
) -> Float[np.ndarray, "*B N"]:
    """Compute `x` with `A x = b` for every symmetric `A` of a stack, scaled to a unit diagonal. `A` may be
    indefinite.

    **Raises:** `numpy.linalg.LinAlgError` where a matrix is exactly singular, such as one with a row of
    zeros.
    """
    scale = _scale(matrix)
    return scale * solve_square(_even(matrix, scale), scale * rhs)


def inverse_symmetric(matrix: Float[np.ndarray, "*B N N"]) -> Float[np.ndarray, "*B N N"]:
    """Compute the symmetric inverse of every symmetric matrix of a stack: covariance from information and
    the reverse.

    The matrix may be indefinite.

    **Raises:** `numpy.linalg.LinAlgError` where a matrix is exactly singular, such as one with a row of
    zeros.
    """
    scale = _scale(matrix)
    found = _even(inverse(_even(matrix, scale)), scale)
    return 0.5 * (found + np.swapaxes(found, -1, -2))


def factor_symmetric(matrix: Float[np.ndarray, "*B N N"]) -> Float[np.ndarray, "*B N N"]:
    """Compute the Cholesky factor: lower triangular `L` with `L L^T = A` and a positive diagonal, for every
    symmetric `A` of a stack. Only the lower triangle of `A` is read.

    **Raises:** `numpy.linalg.LinAlgError` where a matrix is not positive definite.
    """
    return np.linalg.cholesky(matrix)


def raise_spread(
    information: Float[np.ndarray, "N N"], spread: Float[np.ndarray, "N N"], least: float
) -> Float[np.ndarray, "N N"]:
    """Raise a spread to at least `least` times the information, in every direction: the smallest `S' >= S` with `S' >= least A`.

    With `A = L L^T`, the eigenvalues of `L^-1 S L^-T` are raised to `least`.

    **Arguments:** `information`, `A`, is positive definite.
    """
    scale = _scale(information)
    factor = factor_symmetric(_even(information, scale))
    whitened = np.linalg.solve(factor, np.linalg.solve(factor, _even(spread, scale)).T)
    values, vectors = np.linalg.eigh(0.5 * (whitened + whitened.T))
    root = factor @ (vectors * np.sqrt(np.maximum(values, least)))
    return _even(root @ root.T, 1.0 / scale)


def least_squares(matrix: Float[np.ndarray, "R N"], rhs: Float[np.ndarray, "R"]) -> Float[np.ndarray, "N"]:
    """Compute the minimum-norm `x` with the least `|A x - b|`.

    There may be fewer rows than unknowns, and rows may leave some unknowns undetermined.
    """
    return np.linalg.lstsq(matrix, rhs, rcond=None)[0]


def pseudo_inverse(
    matrix: Float[np.ndarray, "*B R N"], rtol: float | None = None, symmetric: bool = False
) -> Float[np.ndarray, "*B N R"]:
    """Compute the pseudo-inverse of every matrix of a stack, without singular values below the share `rtol` of the largest
    (by default the rounding error of NumPy), from eigenvectors where the matrix is `symmetric`.
    """
    return np.linalg.pinv(matrix, hermitian=symmetric, **({} if rtol is None else {"rcond": rtol}))


def low_rank_factors(
    matrix: Float[np.ndarray, "R N"], metric: Float[np.ndarray, "N N"], rank: int
) -> tuple[Float[np.ndarray, "R K"], Float[np.ndarray, "K N"]]:
    """Compute the factors of the best approximation of a matrix by one of lower rank: the least trace of `D M D^T` of the
    difference `D`.

    The columns of the first factor are in descending order of their share. There are fewer of them if the matrix has
    fewer columns than `rank`.

    **Arguments:** `metric`, `M`, is positive definite; the covariance of what the matrix is multiplied by.
    """
    factor = factor_symmetric(metric)
    whitened = matrix @ factor
    # there are few columns, and many rows
    vectors = np.linalg.eigh(whitened.T @ whitened)[1][:, ::-1][:, :rank]
    return whitened @ vectors, np.linalg.solve(factor.T, vectors).T


def factor_sparse(matrix: scipy.sparse.sparray | scipy.sparse.spmatrix) -> scipy.sparse.linalg.SuperLU:
    """Factor a sparse symmetric positive definite matrix with a fill-reducing ordering.

    The `solve` of the result takes right-hand sides `(N,)` or `(N, K)`.

    **Raises:** `RuntimeError` where the matrix is exactly singular.
    """
    columns = scipy.sparse.csc_array(matrix)
    return scipy.sparse.linalg.splu(columns, permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True})


def _scale(matrix: Float[np.ndarray, "*B N N"]) -> Float[np.ndarray, "*B N"]:
    """Compute the scale that makes the diagonal one or minus one; one where the diagonal is zero."""
    size = np.abs(np.diagonal(matrix, axis1=-2, axis2=-1))
    return 1.0 / np.sqrt(np.where(size > 0, size, 1.0))


def _even(
    matrix: Float[np.ndarray, "*B N N"], scale: Float[np.ndarray, "*B N"]
) -> Float[np.ndarray, "*B N N"]:
    return matrix * scale[..., :, None] * scale[..., None, :]
