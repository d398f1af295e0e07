"""Couplings that samples hardly show, taken out of inverse covariances.

Where an entry of an inverse covariance is zero, two numbers are independent given all others.
"""

import numpy as np
from jaxtyping import Float

from .gaussian_mixture import Mixture

#: a coupling is lowered no further than leaves this share of the least eigenvalue, which bounds how
#: much wider than learned a component may become
LEFT = 0.1
#: the share of the way to the bound that a coupling goes at most, so that rounding does not carry it beyond
SHORT = 1 - 1e-6
#: a coupling below this is none
NONE = 1e-6


def partial_correlations(precisions: Float[np.ndarray, "*K D D"]) -> Float[np.ndarray, "*K D D"]:
    """Size of every off-diagonal entry, as a share of the diagonal: zero where two numbers are
    independent given the others, one where they determine each other; ones along the diagonal."""
    scales = np.sqrt(np.diagonal(precisions, axis1=-2, axis2=-1))
    return np.abs(precisions) / (scales[..., :, None] * scales[..., None, :])


def zero_weak(mixture: Mixture, threshold: float) -> Mixture:
    """A mixture without the couplings whose partial correlation is below `threshold`; those that the
    matrix needs to stay positive definite are lowered as far as it does (Adaptation, section 4.1.1).
    """
    weak = partial_correlations(mixture.precisions) < threshold
    weak[:, np.arange(weak.shape[1]), np.arange(weak.shape[1])] = False
    zeroed = np.where(weak, 0.0, mixture.precisions)
    least = LEFT * np.linalg.eigvalsh(mixture.precisions)[:, 0]
    broken = np.linalg.eigvalsh(zeroed)[:, 0] < least
    for k in np.flatnonzero(broken):
        zeroed[k] = lower_weak(mixture.precisions[k], weak[k], least[k])
    return mixture._replace(precisions=zeroed)


def lower_weak(
    precision: Float[np.ndarray, "D D"], weak: np.ndarray, least: float
) -> Float[np.ndarray, "D D"]:
    """The matrix with its weak entries lowered one after the other, the weakest first, each as far as
    leaves no eigenvalue below `least`."""
    rows, columns = np.nonzero(np.triu(weak, 1))
    order = np.argsort(partial_correlations(precision)[rows, columns], kind="stable")
    lowered = precision
    for i, j in zip(rows[order].tolist(), columns[order].tolist(), strict=True):
        lowered = _lower(lowered, i, j, least)
    return lowered


def _lower(matrix: np.ndarray, i: int, j: int, least: float) -> np.ndarray:
    """One entry as near to zero as leaves no eigenvalue below `least`.

    With `C` the inverse of `A = M - least I`, a change of both entries by `t` changes the determinant of `A` by the factor
    `(1 + t C_ij)^2 - t^2 C_ii C_jj`. `A` stays positive definite between the roots of this factor.
    """
    if matrix[i, j] == 0:
        return matrix
    values, vectors = np.linalg.eigh(matrix)
    values = np.maximum(values - least, np.finfo(float).eps * values[-1])
    rows = vectors[[i, j]]
    (ii, ij), (_, jj) = (rows / values) @ rows.T
    mean = np.sqrt(ii * jj)
    most = 1.0 / max(mean - ij, 1e-300) if matrix[i, j] < 0 else 1.0 / max(mean + ij, 1e-300)
    lowered = matrix.copy()
    lowered[i, j] = lowered[j, i] = max(0.0, 1.0 - SHORT * most / abs(matrix[i, j])) * matrix[i, j]
    return lowered


def num_zeroed(precisions: Float[np.ndarray, "K D D"]) -> tuple[int, int]:
    """How many couplings are zero, and how many there could be."""
    above = np.triu_indices(precisions.shape[-1], 1)
    couplings = partial_correlations(precisions)[:, above[0], above[1]]
    return int((couplings < NONE).sum()), couplings.size
