"""The partition of markers into rigid segments, without a known marker placement."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from ...arguments import checked
from .maximal_cliques import maximal_cliques
from .pair_distances import TRIMMED_FRACTION, median_distances, pair_distance_ranges
from .segment_sets import Segments, make_segments

#: description cost of a segment of 1, 2, 3 or more markers, against a marker's squared deviation in units of
#: the usual one: a lone marker explains nothing, so it costs as much as a pair
SEGMENT_COSTS = np.array([0.0, 2.5, 2.5, 3.0])
#: number of thresholds that are tried
NUM_THRESHOLDS = 24
#: least deviation from skin movement, as a share of the body's size: when one joint is exercised most limbs
#: are at rest, and a smaller unit would make all markers of the moving limb loose
SKIN_DEVIATION = 0.006
#: largest deviation between markers on one limb, as a share of the body's size
MAX_DEVIATION = 0.1


class Partition(NamedTuple):
    """Segments, and how they were found."""

    segments: Segments
    #: threshold of the relation "these two keep their distance", metres
    threshold: float
    #: (M, M) range of every pair's distance, metres; NaN for pairs that are never visible together
    deviations: Float[np.ndarray, "M M"]
    #: the cover: all maximal rigid sets, which overlap, the largest first
    rigid_sets: tuple[tuple[int, ...], ...]


@checked
def find_partition(
    positions: Float[np.ndarray, "F M 3"],
    seen: Bool[np.ndarray, "F M"],
    threshold: float | None = None,
    *,
    robust: bool = True,
) -> Partition:
    """Find rigid segments from pairwise distances over the frames (Silaghi et al. 1998, partitioning).

    Two markers are related if their distance varies by less than the threshold. The maximal sets of related
    markers cover all markers. Taken from the largest on, each without the markers taken before, they are a
    partition. Then single markers move to the segment that minimises the description length, as long as
    every two markers of a segment are related. This is necessary as a marker near a joint is rigid to both
    sides, and the largest set would take it from the other side.

    **Arguments:** `threshold` metres; by default the one with the shortest description among candidates from
    the data. `robust` ignores the outer 4 % of each pair's distances at both ends.

    **Raises:** `ValueError` where no two markers keep their distance or are ever visible together, or where
    the threshold is not above zero.
    """
    deviations = pair_distance_ranges(positions, seen, TRIMMED_FRACTION if robust else 0)
    known = np.where(np.isnan(deviations), np.inf, deviations)
    if not np.isfinite(known[np.triu_indices(len(known), 1)]).any():
        raise ValueError("No two markers are ever visible together, so no segment can be found.")
    if threshold is not None:
        if not threshold > 0:
            raise ValueError(f"The threshold is {threshold}; expected a distance above zero, in metres.")
        options, unit = [float(threshold)], 0.6 * float(threshold)
    else:
        size = float(np.nanmax(median_distances(positions, seen)))
        unit = typical_deviation(known, size)
        if unit > MAX_DEVIATION * size:
            raise ValueError(
                "No markers move together: for most markers the distances to all others vary by more than "
                f"{1e3 * unit:.0f} mm. Check that the markers are on one body and that the unit is right; "
                "if so, give a threshold."
            )
        options = np.geomspace(0.5 * unit, 3.0 * unit, NUM_THRESHOLDS).tolist()
    best: tuple[float, float, list[tuple[int, ...]], list[tuple[int, ...]]] | None = None
    for option in options:
        cover = maximal_cliques(known < option, known)
        parts = _reassign_markers(_greedy_partition(cover), known, option, unit)
        length = _description_length(parts, known, unit)
        if best is None or length < best[0] - 1e-9:
            best = length, option, parts, cover
    assert best is not None
    _, chosen, parts, cover = best
    members = sorted((part for part in parts if len(part) > 1), key=lambda part: part[0])
    if not members:
        raise ValueError(
            "No markers move together: all distances between two markers vary by more than "
            f"{1e3 * chosen:.0f} mm. Check that the markers are on one body and that the unit is right; if "
            "so, give a larger threshold."
        )
    weights = attachment_weights(members, known, unit)
    return Partition(make_segments(members, len(known), weights), chosen, deviations, tuple(cover))


def typical_deviation(deviations: Float[np.ndarray, "M M"], body_size: float) -> float:
    """Estimate the usual deviation of markers within a segment, metres.

    It is 1.5 times the 80 % quantile of the deviations from the second most rigid partner, and at least a
    share of the body's size.
    """
    near = np.sort(deviations, axis=1)[:, 1:3]
    second = np.where(np.isfinite(near[:, -1]), near[:, -1], near[:, 0])
    second = second[np.isfinite(second)]
    return max(1.5 * float(np.quantile(second, 0.8)), SKIN_DEVIATION * body_size)


def attachment_weights(members, deviations: Float[np.ndarray, "M M"], scale: float) -> Float[np.ndarray, "M"]:
    """Compute the rigidity of each marker, 0 to 1.

    It is 1 for the most rigid marker and falls with the square of a marker's mean deviation from the others
    of its segment, in units of the usual one.
    """
    weights = np.zeros(len(deviations))
    for some in members:
        inside = deviations[np.ix_(some, some)]
        weights[list(some)] = 1 / (1 + _mean_square_deviations(inside) / scale**2)
    top = weights.max()
    return weights / top if top > 0 else weights


def apply_corrections(
    segments: Segments, labels: tuple[str, ...], corrections: Mapping[str, tuple[str, float]]
) -> Segments:
    """Apply a user's corrections, marker -> (segment, weight), to segments.

    Weight 0, or the segment `-`, makes a marker loose. A segment that does not exist yet is created.

    **Raises:** `ValueError` for a marker that does not exist or a weight outside 0 to 1.
    """
    sets = {name: list(some) for name, some in zip(segments.names, segments.members, strict=True)}
    weights = segments.weights.copy()
    for label, (name, weight) in corrections.items():
        if label not in labels:
            raise ValueError(f"There is no marker '{label}' to correct; expected one of {', '.join(labels)}.")
        if not 0 <= weight <= 1:
            raise ValueError(f"The weight of marker '{label}' is {weight}; expected 0 to 1.")
        marker = labels.index(label)
        for some in sets.values():
            if marker in some:
                some.remove(marker)
        if name != "-" and weight > 0:
            sets.setdefault(name, []).append(marker)
        weights[marker] = weight
    kept = {name: some for name, some in sets.items() if some}
    return make_segments(kept.values(), len(labels), weights, tuple(kept))


def _greedy_partition(rigid_sets: list[tuple[int, ...]]) -> list[tuple[int, ...]]:
    left = [set(some) for some in rigid_sets]
    parts = []
    while left:
        # the cover's order breaks ties
        place = max(range(len(left)), key=lambda k: (len(left[k]), -k))
        taken = left[place]
        parts.append(tuple(sorted(taken)))
        left = [rest for some in left if (rest := some - taken)]
    return parts


def _reassign_markers(
    parts: list[tuple[int, ...]], deviations: np.ndarray, threshold: float, scale: float
) -> list[tuple[int, ...]]:
    """Move markers one by one while this shortens the description."""
    count = len(deviations)
    sets = [list(part) for part in parts]
    for _ in range(4 * count):
        costs = [_segment_cost(some, deviations, scale) for some in sets]
        best, move = -1e-9, None
        for a, some in enumerate(sets):
            for marker in some:
                left = [m for m in some if m != marker]
                gain = _segment_cost(left, deviations, scale) - costs[a]
                for b in range(len(sets) + 1):
                    other = sets[b] if b < len(sets) else []
                    if b == a or (other and deviations[marker, other].max() >= threshold):
                        continue
                    change = (
                        gain
                        + _segment_cost([*other, marker], deviations, scale)
                        - (costs[b] if other else 0.0)
                    )
                    if change < best:
                        best, move = change, (a, b, marker)
        if move is None:
            break
        a, b, marker = move
        sets[a].remove(marker)
        if b == len(sets):
            sets.append([])
        sets[b].append(marker)
        sets = [some for some in sets if some]
    return [tuple(sorted(some)) for some in sets]


def _segment_cost(members: list[int], deviations: np.ndarray, scale: float) -> float:
    cost = float(SEGMENT_COSTS[min(len(members), 3)])
    if len(members) > 1:
        cost += float(_mean_square_deviations(deviations[np.ix_(members, members)]).sum()) / scale**2
    return cost


def _description_length(parts: list[tuple[int, ...]], deviations: np.ndarray, scale: float) -> float:
    return sum(_segment_cost(list(part), deviations, scale) for part in parts)


def _mean_square_deviations(deviations: np.ndarray) -> np.ndarray:
    """Compute the mean square deviation of each marker from the others."""
    return (deviations**2).sum(1) / max(len(deviations) - 1, 1)
