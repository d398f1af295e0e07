"""How much the distances between markers change over the frames."""

import numpy as np
from jaxtyping import Bool, Float

#: frames that are looked at, evenly over the take
FRAMES = 1200
#: the share of frames at each end that the robust form leaves out: a marker that wears another's label
#: in 1 % of the frames spoils 2 % of a pair's
TAIL = 0.04
#: a pair seen together in fewer frames than this tells nothing
FEWEST = 10


def pair_deviations(
    places: Float[np.ndarray, "F M 3"], seen: Bool[np.ndarray, "F M"], tail: float | int = TAIL
) -> Float[np.ndarray, "M M"]:
    """The range of every pair's distance over the frames in which both are seen, metres.

    With `tail` 0 the paper's measure, the longest less the shortest distance (Silaghi et al. 1998,
    partitioning); else the range between two quantiles, which stands gaps and swapped labels. NaN for
    pairs that are never seen together long enough.
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
    """The median distance of every pair over the frames in which both are seen, metres; NaN where
    there are none."""
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
