"""Markers that move as one rigid body, and how they move among others."""

import numpy as np
from jaxtyping import Float

from ...geometry.sampling import even_indices
from ...observe.markers import MarkerFrames
from .maximal_cliques import maximal_cliques
from .pair_distances import pair_distance_ranges

#: largest range of a distance on a rigid body, metres: noise and small errors of cameras; skin moves by more
MAX_RANGE = 0.012
#: least number of markers of a rigid body
MIN_MARKERS = 3
#: displacement of a marker above which its body moves, metres
MIN_DISPLACEMENT = 0.3
#: number of frames that displacements are measured in
NUM_FRAMES = 200


def distance_ranges(frames: MarkerFrames) -> Float[np.ndarray, "M M"]:
    """Compute the range of every pair's distance without its outer values, metres; NaN where never visible together."""
    return pair_distance_ranges(np.asarray(frames.positions, float), np.asarray(frames.visible))


def is_rigid(ranges: Float[np.ndarray, "M M"], members: list[int]) -> bool:
    """Test if all distances between at least three markers are constant, as far as both are visible."""
    if len(members) < MIN_MARKERS:
        return False
    inside = ranges[np.ix_(members, members)]
    pairs = inside[np.triu_indices(len(members), 1)]
    known = np.isfinite(pairs)
    # every marker has to be seen with two others
    partners = np.isfinite(inside).sum(1) - 1
    return bool(known.any() and (partners >= 2).all() and pairs[known].max() < MAX_RANGE)


def find_rigid_sets(ranges: Float[np.ndarray, "M M"], candidates: list[int]) -> list[list[int]]:
    """Find disjoint sets of at least three candidates with constant distances, the largest first."""
    sets, left = [], list(candidates)
    while len(left) >= MIN_MARKERS:
        inside = ranges[np.ix_(left, left)]
        inside = np.where(np.isfinite(inside), inside, np.inf)
        best = maximal_cliques(inside < MAX_RANGE, inside)[0]
        if len(best) < MIN_MARKERS:
            break
        sets.append([left[k] for k in best])
        left = [index for index in left if index not in sets[-1]]
    return sets


def own_motion(ranges: Float[np.ndarray, "M M"], members: list[int], others: list[int]) -> float:
    """Measure how far a rigid set moves against each of the other markers, at least, metres.

    A set on a bone keeps its distances from the markers next to its joints; an object of its own keeps none. Infinite without
    other markers.
    """
    if not others:
        return np.inf
    against = ranges[np.ix_(members, others)]
    known = np.isfinite(against)
    farthest = np.where(known, against, 0.0).max(0)
    return float(np.min(farthest, initial=np.inf, where=known.any(0)))


def displacement(frames: MarkerFrames, outer: float = 0.02) -> float:
    """Measure the largest displacement of a marker along an axis, without a share of `outer` values at both ends, metres."""
    some = even_indices(len(frames), NUM_FRAMES, nearest=True)
    positions, seen = np.asarray(frames.positions, float)[some], np.asarray(frames.visible)[some]
    shown = seen.any(0)
    if not shown.any():
        return 0.0
    places = np.where(seen[..., None], positions, np.nan)[:, shown]
    low, high = np.nanquantile(places, [outer, 1 - outer], axis=0)
    return float(np.max(high - low))
