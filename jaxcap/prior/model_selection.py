"""Selection of the number of Gaussians and of their couplings by cross-validated likelihood."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from .covariance_selection import threshold_couplings
from .gaussian_mixture import MIN_DEVIATION, GaussianMixture, fit_mixture, mixture_log_density

#: thresholds of partial correlation below which couplings are removed, from none to all
THRESHOLDS = (0.0, 0.05, 0.1, 0.2, 0.3, 0.5, 1.01)
#: up to this many poses, leave-one-out folds; beyond, this number of blocks of successive poses
MAX_LEAVE_ONE_OUT, NUM_BLOCKS = 100, 10
#: stop after this many numbers of components without a gain
PATIENCE = 2
#: starts of the final fit; the most likely is kept
NUM_RESTARTS = 4


class MixtureSelection(NamedTuple):
    """The mixture of all samples, with the number of components and the couplings that predict best.

    `held_out` is the mean log-likelihood of left-out samples by number of components (from one) and by
    threshold (`THRESHOLDS`); minus infinity where it was not evaluated.
    """

    mixture: GaussianMixture
    held_out: Float[np.ndarray, "C T"]
    threshold: float

    @property
    def best_log_likelihood(self) -> float:
        """Held-out log-likelihood of the selected mixture."""
        return float(self.held_out.max())

    @property
    def single_log_likelihood(self) -> float:
        """Held-out log-likelihood of one Gaussian with all couplings."""
        return float(self.held_out[0, 0])


def cross_validation_folds(
    count: int, max_leave_one_out: int = MAX_LEAVE_ONE_OUT, num_blocks: int = NUM_BLOCKS
) -> Int[np.ndarray, "N"]:
    """Assign samples to cross-validation folds.

    Few samples are left out one by one. Otherwise a fold is a block of successive samples, as neighbouring
    frames of a motion are alike and would predict each other.
    """
    return np.arange(count) if count <= max_leave_one_out else np.arange(count) * num_blocks // count


def select_mixture(
    samples: Float[np.ndarray, "N D"],
    *,
    max_components: int = 10,
    min_deviation: float = MIN_DEVIATION,
    seed: int = 0,
) -> MixtureSelection:
    """Select the number of components and the couplings of a mixture by cross-validation.

    The mean *log*-likelihood of left-out samples decides (Adaptation, section 4.1.1): a mean of likelihoods
    would depend on few samples. All sets of couplings cannot be evaluated (there are 2^15 for each
    component), so couplings are removed by size, at `THRESHOLDS`. Of equally good models the simpler is
    taken.

    **Arguments:** `max_components` is the most components.

    **Raises:** `ValueError` if there are fewer than 4 samples, or if a sample is not finite.
    """
    if len(samples) < 4:
        raise ValueError(f"There are {len(samples)} poses; expected at least 4 to learn a mixture.")
    folds = cross_validation_folds(len(samples))
    # leave at least two training samples for each component
    max_components = max(1, min(max_components, (len(samples) - np.bincount(folds).max()) // 2))
    held_out = np.full((max_components, len(THRESHOLDS)), -np.inf)
    for row in range(max_components):
        held_out[row] = _cross_validate(samples, folds, row + 1, min_deviation, seed)
        if row - np.argmax(held_out.max(1)) >= PATIENCE:
            break
    # columns in reverse order, so that of equal models the one with fewest couplings comes first
    count, column = np.unravel_index(np.argmax(held_out[:, ::-1]), held_out.shape)
    threshold = THRESHOLDS[::-1][column]
    fits = [
        fit_mixture(samples, int(count) + 1, min_deviation=min_deviation, seed=seed + i)
        for i in range(NUM_RESTARTS)
    ]
    likeliest = max(fits, key=lambda fit: fit.history[-1]).mixture
    return MixtureSelection(threshold_couplings(likeliest, threshold), held_out, threshold)


def _cross_validate(
    samples, folds, num_components: int, min_deviation: float, seed: int
) -> Float[np.ndarray, "T"]:
    """Compute the mean log-likelihood of left-out samples at each threshold."""
    totals = np.zeros(len(THRESHOLDS))
    for fold in range(folds.max() + 1):
        out = folds == fold
        mixture = fit_mixture(samples[~out], num_components, min_deviation=min_deviation, seed=seed).mixture
        totals += [
            mixture_log_density(threshold_couplings(mixture, limit), samples[out]).sum()
            for limit in THRESHOLDS
        ]
    return totals / len(samples)
