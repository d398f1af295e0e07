"""Covariance selection: set weak couplings in inverse covariances to zero.

A zero entry of an inverse covariance means that two variables are conditionally independent given all others.
"""

import numpy as np
from jaxtyping import Float

from .gaussian_mixture import GaussianMixture

#: lowering a coupling keeps the eigenvalues above this share of the least one, which bounds how far a
#: component widens
MIN_EIGENVALUE_SHARE = 0.1
#: the most of the distance to that bound that a coupling moves, as a margin for rounding
STEP_SHARE = 1 - 1e-6
#: partial correlations below this count as zero
ZERO_TOLERANCE = 1e-6


def partial_correlations(precisions: Float[np.ndarray, "*K D D"]) -> Float[np.ndarray, "*K D D"]:
    """Compute absolute partial correlations from inverse covariances.

    An entry is zero where two variables are independent given the others, and one where they determine each
    other. The diagonal is one.
    """
    scales = np.sqrt(np.diagonal(precisions, axis1=-2, axis2=-1))
    return np.abs(precisions) / (scales[..., :, None] * scales[..., None, :])


def threshold_couplings(mixture: GaussianMixture, threshold: float) -> GaussianMixture:
    """Set couplings with a partial correlation below `threshold` to zero (Adaptation, section 4.1.1).

    If this would make a matrix indefinite, its weak couplings are lowered as far as it stays positive
    definite.
    """
    weak = partial_correlations(mixture.precisions) < threshold
    weak[:, np.arange(weak.shape[1]), np.arange(weak.shape[1])] = False
    zeroed = np.where(weak, 0.0, mixture.precisions)
    least = MIN_EIGENVALUE_SHARE * np.linalg.eigvalsh(mixture.precisions)[:, 0]
    broken = np.linalg.eigvalsh(zeroed)[:, 0] < least
    for k in np.flatnonzero(broken):
        zeroed[k] = shrink_couplings(mixture.precisions[k], weak[k], least[k])
    return mixture._replace(precisions=zeroed)


def shrink_couplings(
    precision: Float[np.ndarray, "D D"], weak: np.ndarray, min_eigenvalue: float
) -> Float[np.ndarray, "D D"]:
    """Lower weak entries of a matrix in turn, the weakest first, keeping eigenvalues above `min_eigenvalue`."""
    rows, columns = np.nonzero(np.triu(weak, 1))
    order = np.argsort(partial_correlations(precision)[rows, columns], kind="stable")
    lowered = precision
    for i, j in zip(rows[order].tolist(), columns[order].tolist(), strict=True):
        lowered = _shrink_coupling(lowered, i, j, min_eigenvalue)
    return lowered


def _shrink_coupling(matrix: np.ndarray, i: int, j: int, min_eigenvalue: float) -> np.ndarray:
    """Move one entry towards zero as far as all eigenvalues stay above `min_eigenvalue`.

    With `C` the inverse of `A = M - min_eigenvalue I`, a change of both entries by `t` changes the determinant
    of `A` by the factor `(1 + t C_ij)^2 - t^2 C_ii C_jj`. `A` stays positive definite between the roots of
    this factor.
    """
    if matrix[i, j] == 0:
        return matrix
    values, vectors = np.linalg.eigh(matrix)
    values = np.maximum(values - min_eigenvalue, np.finfo(float).eps * values[-1])
    rows = vectors[[i, j]]
    (ii, ij), (_, jj) = (rows / values) @ rows.T
    mean = np.sqrt(ii * jj)
    most = 1.0 / max(mean - ij, 1e-300) if matrix[i, j] < 0 else 1.0 / max(mean + ij, 1e-300)
    lowered = matrix.copy()
    lowered[i, j] = lowered[j, i] = max(0.0, 1.0 - STEP_SHARE * most / abs(matrix[i, j])) * matrix[i, j]
    return lowered


def count_zero_couplings(precisions: Float[np.ndarray, "K D D"]) -> tuple[int, int]:
    """Count the couplings that are zero, and all couplings."""
    above = np.triu_indices(precisions.shape[-1], 1)
    couplings = partial_correlations(precisions)[:, above[0], above[1]]
    return int((couplings < ZERO_TOLERANCE).sum()), couplings.size
