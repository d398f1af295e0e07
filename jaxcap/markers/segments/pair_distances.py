"""Variation of the distances between markers over the frames."""

import numpy as np
from jaxtyping import Bool, Float

#: number of frames that are used, evenly over the take
FRAMES = 1200
#: share of frames that the robust form trims at each end: a marker with a swapped label in 1 % of the frames
#: corrupts 2 % of a pair's
TAIL = 0.04
#: fewest frames with both markers visible
FEWEST = 10


def pair_deviations(
    places: Float[np.ndarray, "F M 3"], seen: Bool[np.ndarray, "F M"], tail: float | int = TAIL
) -> Float[np.ndarray, "M M"]:
    """Compute the range of every pair's distance over the frames with both visible, metres.

    With `tail` 0 this is the paper's measure, the longest minus the shortest distance (Silaghi et al. 1998,
    partitioning). Otherwise it is the range between two quantiles, which is robust to gaps and swapped
    labels. NaN for pairs with too few common frames.
    """
    chosen = np.unique(np.linspace(0, len(places) - 1, min(FRAMES, len(places))).round().astype(int))
    if tail == 0:
        chosen = np.arange(len(places))
    places, seen = places[chosen], seen[chosen]
    fewest = min(FEWEST, len(places))
    count = places.shape[1]
    deviations = np.full((count, count), np.nan)
    np.fill_diagonal(deviations, 0.0)
    for i in range(count - 1):
        distances = np.linalg.norm(places[:, i + 1 :] - places[:, i : i + 1], axis=-1)
        both = seen[:, i + 1 :] & seen[:, i : i + 1]
        enough = both.sum(0) >= fewest
        if not enough.any():
            continue
        known = np.where(both, distances, np.nan)[:, enough]
        low, high = np.nanquantile(known, [tail, 1 - tail], axis=0)
        deviations[i, i + 1 :][enough] = high - low
    return np.fmax(deviations, deviations.T)


def median_distances(
    places: Float[np.ndarray, "F M 3"], seen: Bool[np.ndarray, "F M"]
) -> Float[np.ndarray, "M M"]:
    """Compute the median distance of every pair over the frames with both visible, metres; NaN where none."""
    chosen = np.unique(np.linspace(0, len(places) - 1, min(FRAMES, len(places))).round().astype(int))
    places, seen = places[chosen], seen[chosen]
    count = places.shape[1]
    medians = np.full((count, count), np.nan)
    for i in range(count):
        known = np.where(
            seen & seen[:, i : i + 1], np.linalg.norm(places - places[:, i : i + 1], axis=-1), np.nan
        )
        some = ~np.isnan(known).all(0)
        medians[i, some] = np.nanmedian(known[:, some], axis=0)
    return medians
