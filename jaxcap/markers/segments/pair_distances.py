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
#: share of the frames over which displacements are measured, so that motion is larger than noise
DISPLACEMENT_LAG = 0.01
#: displacement that has half of the largest weight, as a share of the root mean square of all
HALF_WEIGHT_DISPLACEMENT = 0.5
#: weight of a frame in which both markers of a pair stand still
MIN_FRAME_WEIGHT = 1e-3


def motion_weights(
    positions: Float[np.ndarray, "F M 3"], seen: Bool[np.ndarray, "F M"]
) -> Float[np.ndarray, "F M"]:
    """Compute the weight of every marker in every frame by its displacement in the world, near 0 to 1.

    Two markers that stand still keep their distance, whatever they are on: feet on the floor are no rigid body. Only frames in
    which one of the two moves are evidence. Displacements are those over a hundredth of the take.
    """
    count = len(positions)
    lag = max(1, round(0.5 * DISPLACEMENT_LAG * count))
    before, after = np.maximum(np.arange(count) - lag, 0), np.minimum(np.arange(count) + lag, count - 1)
    both = seen[before] & seen[after]
    moved = np.where(both, np.sum((positions[after] - positions[before]) ** 2, -1), 0.0)
    half = HALF_WEIGHT_DISPLACEMENT**2 * moved.sum() / max(both.sum(), 1)
    return MIN_FRAME_WEIGHT + moved / np.maximum(moved + half, 1e-300)


def pair_distance_ranges(
    positions: Float[np.ndarray, "F M 3"],
    seen: Bool[np.ndarray, "F M"],
    trimmed_fraction: float | int = TRIMMED_FRACTION,
    weights: Float[np.ndarray, "F M"] | None = None,
) -> Float[np.ndarray, "M M"]:
    """Compute the range of every pair's distance over the frames with both visible, metres.

    With `trimmed_fraction` 0 this is the paper's measure, the longest minus the shortest distance (Silaghi et al. 1998,
    partitioning). Otherwise it is the range between two quantiles, which is robust to gaps and swapped
    labels. NaN for pairs with too few common frames. With `weights` of the markers (`motion_weights`) each frame counts by the
    larger weight of the pair.
    """
    chosen = even_indices(len(positions), MAX_FRAMES, nearest=True)
    if trimmed_fraction == 0:
        chosen = np.arange(len(positions))
    positions, seen = positions[chosen], seen[chosen]
    weights = np.ones(seen.shape) if weights is None else weights[chosen]
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
        shares = np.where(both, np.maximum(weights[:, i + 1 :], weights[:, i : i + 1]), 0.0)
        low, high = weighted_quantiles(
            distances[:, enough], shares[:, enough], (float(trimmed_fraction), 1.0 - trimmed_fraction)
        )
        deviations[i, i + 1 :][enough] = high - low
    return np.fmax(deviations, deviations.T)


def weighted_quantiles(
    values: Float[np.ndarray, "F N"], weights: Float[np.ndarray, "F N"], fractions: tuple[float, ...]
) -> list[Float[np.ndarray, "N"]]:
    """Compute quantiles of each column by the weights of its values, as of a step function; values of weight zero do not count."""
    order = np.argsort(np.where(weights > 0, values, np.inf), axis=0)
    ordered, totals = (
        np.take_along_axis(values, order, 0),
        np.cumsum(np.take_along_axis(weights, order, 0), 0),
    )
    # the last value is never beyond those with weight
    counts = (weights > 0).sum(0)
    found = []
    for fraction in fractions:
        rows = (totals < fraction * totals[-1] * (1 - 1e-12)).sum(0)
        found.append(np.take_along_axis(ordered, np.minimum(rows, counts - 1)[None], 0)[0])
    return found


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
