"""Selection of the number of Gaussians and of their couplings by cross-validated likelihood."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from .covariance_selection import zero_weak
from .gaussian_mixture import FLOOR, Mixture, fit_mixture, log_density

#: thresholds of partial correlation below which couplings are removed, from none to all
THRESHOLDS = (0.0, 0.05, 0.1, 0.2, 0.3, 0.5, 1.01)
#: up to this many poses, leave-one-out folds; beyond, this number of blocks of successive poses
SINGLE, BLOCKS = 100, 10
#: stop after this many numbers of components without a gain
PATIENCE = 2
#: starts of the final fit; the most likely is kept
STARTS = 4


class Chosen(NamedTuple):
    """The mixture of all samples, with the number of components and the couplings that predict best.

    `held_out` is the mean log-likelihood of left-out samples by number of components (from one) and by
    threshold (`THRESHOLDS`); minus infinity where it was not evaluated.
    """

    mixture: Mixture
    held_out: Float[np.ndarray, "C T"]
    threshold: float

    @property
    def best(self) -> float:
        """Held-out log-likelihood of the selected mixture."""
        return float(self.held_out.max())

    @property
    def single(self) -> float:
        """Held-out log-likelihood of one Gaussian with all couplings."""
        return float(self.held_out[0, 0])


def held_out_folds(count: int, single: int = SINGLE, blocks: int = BLOCKS) -> Int[np.ndarray, "N"]:
    """Assign samples to cross-validation folds.

    Few samples are left out one by one. Otherwise a fold is a block of successive samples, as neighbouring
    frames of a motion are alike and would predict each other.
    """
    return np.arange(count) if count <= single else np.arange(count) * blocks // count


def choose_mixture(
    samples: Float[np.ndarray, "N D"],
    *,
    most: int = 10,
    floor: float = FLOOR,
    seed: int = 0,
) -> Chosen:
    """Select the number of components and the couplings of a mixture by cross-validation.

    The mean *log*-likelihood of left-out samples decides (Adaptation, section 4.1.1): a mean of likelihoods
    would depend on few samples. All sets of couplings cannot be evaluated (there are 2^15 for each
    component), so couplings are removed by size, at `THRESHOLDS`. Of equally good models the simpler is
    taken.

    **Arguments:** `most` is the most components.

    **Raises:** `ValueError` if there are fewer than 4 samples, or if a sample is not finite.
    """
    if len(samples) < 4:
        raise ValueError(f"There are {len(samples)} poses; expected at least 4 to learn a mixture.")
    folds = held_out_folds(len(samples))
    # leave at least two training samples for each component
    most = max(1, min(most, (len(samples) - np.bincount(folds).max()) // 2))
    held_out = np.full((most, len(THRESHOLDS)), -np.inf)
    for row in range(most):
        held_out[row] = _held_out(samples, folds, row + 1, floor, seed)
        if row - np.argmax(held_out.max(1)) >= PATIENCE:
            break
    # columns in reverse order, so that of equal models the one with fewest couplings comes first
    count, column = np.unravel_index(np.argmax(held_out[:, ::-1]), held_out.shape)
    threshold = THRESHOLDS[::-1][column]
    fits = [fit_mixture(samples, int(count) + 1, floor=floor, seed=seed + i) for i in range(STARTS)]
    likeliest = max(fits, key=lambda fit: fit.history[-1]).mixture
    return Chosen(zero_weak(likeliest, threshold), held_out, threshold)


def _held_out(samples, folds, count: int, floor: float, seed: int) -> Float[np.ndarray, "T"]:
    """Compute the mean log-likelihood of left-out samples at each threshold."""
    totals = np.zeros(len(THRESHOLDS))
    for fold in range(folds.max() + 1):
        out = folds == fold
        mixture = fit_mixture(samples[~out], count, floor=floor, seed=seed).mixture
        totals += [log_density(zero_weak(mixture, limit), samples[out]).sum() for limit in THRESHOLDS]
    return totals / len(samples)
