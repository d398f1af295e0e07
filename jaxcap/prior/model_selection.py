"""How many Gaussians, and which couplings in them: by the likelihood of poses that were left out."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from .covariance_selection import zero_weak
from .gaussian_mixture import FLOOR, Mixture, fit_mixture, log_density

#: partial correlations below which couplings are taken out, from none of them to all
THRESHOLDS = (0.0, 0.05, 0.1, 0.2, 0.3, 0.5, 1.01)
#: up to so many poses each is left out by itself, beyond them this many blocks of successive ones
SINGLE, BLOCKS = 100, 10
#: numbers of components without a gain, after which no more are tried
PATIENCE = 2
#: starts of the last fit, of which the likeliest is kept
STARTS = 4


class Chosen(NamedTuple):
    """The mixture of all samples with the number of components and the couplings that foretell best.

    `held_out` has the mean log-likelihood of samples that were left out, by number of components (from
    one) and threshold (`THRESHOLDS`); minus infinity where none was tried.
    """

    mixture: Mixture
    held_out: Float[np.ndarray, "C T"]
    threshold: float

    @property
    def best(self) -> float:
        """Held-out log-likelihood of what was chosen."""
        return float(self.held_out.max())

    @property
    def single(self) -> float:
        """That of one Gaussian with all its couplings."""
        return float(self.held_out[0, 0])


def held_out_folds(count: int, single: int = SINGLE, blocks: int = BLOCKS) -> Int[np.ndarray, "N"]:
    """Which samples are left out together: each by itself where there are few, and else blocks of
    successive ones, as neighbouring frames of a motion are alike and would foretell each other."""
    return np.arange(count) if count <= single else np.arange(count) * blocks // count


def choose_mixture(
    samples: Float[np.ndarray, "N D"],
    *,
    most: int = 10,
    floor: float = FLOOR,
    seed: int = 0,
) -> Chosen:
    """The mixture whose number of components, 1 to `most`, and couplings make left-out samples
    likeliest (Adaptation, section 4.1.1).

    The mean *log*-likelihood decides, as one lucky sample among many would decide a mean of
    likelihoods. All sets of couplings cannot be tried (there are 2^15 for each component), so they
    go in the order of their size, by `THRESHOLDS`. Where two do as well, the simpler is taken.

    **Raises:** `ValueError` where there are fewer than 4 samples, or one is not finite.
    """
    if len(samples) < 4:
        raise ValueError(f"There are {len(samples)} poses; a mixture is learned from 4 at least.")
    folds = held_out_folds(len(samples))
    # half the rest at least, so that no component is of a single sample
    most = max(1, min(most, (len(samples) - np.bincount(folds).max()) // 2))
    held_out = np.full((most, len(THRESHOLDS)), -np.inf)
    for row in range(most):
        held_out[row] = _held_out(samples, folds, row + 1, floor, seed)
        if row - np.argmax(held_out.max(1)) >= PATIENCE:
            break
    # columns from all couplings taken out, so that the first of equals has fewest
    count, column = np.unravel_index(np.argmax(held_out[:, ::-1]), held_out.shape)
    threshold = THRESHOLDS[::-1][column]
    fits = [fit_mixture(samples, int(count) + 1, floor=floor, seed=seed + i) for i in range(STARTS)]
    likeliest = max(fits, key=lambda fit: fit.history[-1]).mixture
    return Chosen(zero_weak(likeliest, threshold), held_out, threshold)


def _held_out(samples, folds, count: int, floor: float, seed: int) -> Float[np.ndarray, "T"]:
    """Mean log-likelihood of left-out samples at each threshold."""
    totals = np.zeros(len(THRESHOLDS))
    for fold in range(folds.max() + 1):
        out = folds == fold
        mixture = fit_mixture(samples[~out], count, floor=floor, seed=seed).mixture
        totals += [log_density(zero_weak(mixture, limit), samples[out]).sum() for limit in THRESHOLDS]
    return totals / len(samples)
