"""Variation of the distances between markers over the frames."""

import numpy as np
from jaxtyping import Bool, Float

from ...geometry.sampling import even_indices

#: number of frames that are used, evenly over the take
MAX_FRAMES = 1200
#: share of frames that the robust form trims at each end: a marker with a swapped label in 1 % of the frames
#: corrupts 2 % of a pair's
TRIMMED_FRACTION = 0.04
#: fewest frames with both markers visible
MIN_COMMON_FRAMES = 10


def pair_distance_ranges(
    positions: Float[np.ndarray, "F M 3"],
    seen: Bool[np.ndarray, "F M"],
    trimmed_fraction: float | int = TRIMMED_FRACTION,
) -> Float[np.ndarray, "M M"]:
    """Compute the range of every pair's distance over the frames with both visible, metres.

    With `trimmed_fraction` 0 this is the paper's measure, the longest minus the shortest distance (Silaghi et al. 1998,
    partitioning). Otherwise it is the range between two quantiles, which is robust to gaps and swapped
    labels. NaN for pairs with too few common frames.
    """
    chosen = even_indices(len(positions), MAX_FRAMES, nearest=True)
    if trimmed_fraction == 0:
        chosen = np.arange(len(positions))
    positions, seen = positions[chosen], seen[chosen]
    fewest = min(MIN_COMMON_FRAMES, len(positions))
    count = positions.shape[1]
    deviations = np.full((count, count), np.nan)
    np.fill_diagonal(deviations, 0.0)
    for i in range(count - 1):
        distances = np.linalg.norm(positions[:, i + 1 :] - positions[:, i : i + 1], axis=-1)
        both = seen[:, i + 1 :] & seen[:, i : i + 1]
        enough = both.sum(0) >= fewest
        if not enough.any():
            continue
        known = np.where(both, distances, np.nan)[:, enough]
        low, high = np.nanquantile(known, [trimmed_fraction, 1 - trimmed_fraction], axis=0)
        deviations[i, i + 1 :][enough] = high - low
    return np.fmax(deviations, deviations.T)


def median_distances(
    positions: Float[np.ndarray, "F M 3"], seen: Bool[np.ndarray, "F M"]
) -> Float[np.ndarray, "M M"]:
    """Compute the median distance of every pair over the frames with both visible, metres; NaN where none."""
    chosen = even_indices(len(positions), MAX_FRAMES, nearest=True)
    positions, seen = positions[chosen], seen[chosen]
    count = positions.shape[1]
    medians = np.full((count, count), np.nan)
    for i in range(count):
        known = np.where(
            seen & seen[:, i : i + 1], np.linalg.norm(positions - positions[:, i : i + 1], axis=-1), np.nan
        )
        some = ~np.isnan(known).all(0)
        medians[i, some] = np.nanmedian(known[:, some], axis=0)
    return medians
