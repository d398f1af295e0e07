"""The partition of markers into rigid segments, without a known marker placement."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from ...arguments import checked
from .pair_distances import TRIMMED_FRACTION, median_distances, motion_weights, pair_distance_ranges
from .segment_sets import Segments, make_segments

#: description cost of a segment of 1, 2, 3 or more markers, against a marker's squared deviation in units of
#: the usual one: a lone marker explains nothing, so it costs as much as a pair
SEGMENT_COSTS = np.array([0.0, 2.5, 2.5, 3.0])
#: usual deviation, as a multiple of the 80 % quantile of the deviations of markers from their second most rigid partner
UNIT_RATIO = 1.2
#: usual deviation, as a share of a given threshold
THRESHOLD_SHARE = 0.6
#: factor on the usual deviation for the markers that are alone in their sets, and the deviation that then counts as much as a
#: metre between two markers: those of a bone are near each other
LOOSE_RATIO, COMPACTNESS = 2.0, 0.03
#: least deviation from skin movement, as a share of the body's size: when one joint is exercised most limbs
#: are at rest, and a smaller unit would make all markers of the moving limb loose
SKIN_DEVIATION = 0.006
#: largest deviation between markers on one limb, as a share of the body's size
MAX_DEVIATION = 0.1
#: squared deviation, in units, of markers that cannot be on one segment
EXCLUDED = 1e9


class Partition(NamedTuple):
    """Segments, and how they were found."""

    segments: Segments
    #: the usual deviation between markers of a segment, metres
    unit: float
    #: (M, M) range of every pair's distance (`pair_deviations`), metres; NaN for pairs that are never visible together
    deviations: Float[np.ndarray, "M M"]


@checked
def find_partition(
    positions: Float[np.ndarray, "F M 3"],
    seen: Bool[np.ndarray, "F M"],
    threshold: float | None = None,
    *,
    robust: bool = True,
) -> Partition:
    """Find rigid segments from pairwise distances over the frames (Silaghi et al. 1998, partitioning).

    Two markers of a segment keep their distance while they move. The partition minimises the length of its description: a
    cost for each segment, and the squared deviations of its markers in units of the usual one. Sets of markers merge, those
    that save most first, and then single markers move to other sets, until nothing is shorter. Markers alone in a set are
    partitioned again with twice the unit, as skin moves more on a fast limb, into sets of three and more; others are loose.

    **Arguments:** `threshold` metres, which no two markers of a segment exceed; by default there is none, and the usual
    deviation is estimated. `robust` ignores the outer 4 % of each pair's distances at both ends.

    **Raises:** `ValueError` where no two markers keep their distance or are ever visible together, or where
    the threshold is not above zero.
    """
    deviations, unit = pair_deviations(positions, seen, robust=robust)
    known = np.where(np.isnan(deviations), np.inf, deviations)
    if not np.isfinite(known[np.triu_indices(len(known), 1)]).any():
        raise ValueError("No two markers are ever visible together, so no segment can be found.")
    if threshold is not None:
        if not threshold > 0:
            raise ValueError(f"The threshold is {threshold}; expected a distance above zero, in metres.")
        unit = THRESHOLD_SHARE * float(threshold)
    elif unit > MAX_DEVIATION * float(np.nanmax(median_distances(positions, seen))):
        raise ValueError(
            "No markers move together: for most markers the distances to all others vary by more than "
            f"{1e3 * unit:.0f} mm. Check that the markers are on one body and that the unit is right; "
            "if so, give a threshold."
        )
    parts = cluster_markers(known, unit, np.inf if threshold is None else float(threshold))
    if threshold is None:
        loose = np.array([part[0] for part in parts if len(part) == 1], int)
        apart = np.hypot(known, COMPACTNESS * np.nan_to_num(median_distances(positions, seen)))
        again = cluster_markers(apart[np.ix_(loose, loose)], LOOSE_RATIO * unit) if len(loose) > 2 else []
        parts += [tuple(loose[list(part)].tolist()) for part in again if len(part) > 2]
    members = sorted((part for part in parts if len(part) > 1), key=lambda part: part[0])
    if not members:
        raise ValueError(
            "No markers move together: all distances between two markers vary by more than "
            f"{1e3 * unit:.0f} mm. Check that the markers are on one body and that the unit is right; if "
            "so, give a larger threshold."
        )
    return Partition(
        make_segments(members, len(known), attachment_weights(members, known, unit)), unit, deviations
    )


def pair_deviations(
    positions: Float[np.ndarray, "F M 3"], seen: Bool[np.ndarray, "F M"], *, robust: bool = True
) -> tuple[Float[np.ndarray, "M M"], float]:
    """Compute how far the distance of every pair varies, and the usual deviation in a segment, metres.

    It is the larger one of the ranges over all frames, and over those in which one of the two moves.
    """
    trimmed = TRIMMED_FRACTION if robust else 0
    deviations = np.fmax(
        pair_distance_ranges(positions, seen, trimmed),
        pair_distance_ranges(positions, seen, trimmed, motion_weights(positions, seen)),
    )
    size = float(np.max(median_distances(positions, seen), initial=0.0, where=np.isfinite(deviations)))
    return deviations, typical_deviation(np.where(np.isnan(deviations), np.inf, deviations), size)


def typical_deviation(deviations: Float[np.ndarray, "M M"], body_size: float) -> float:
    """Estimate the usual deviation of markers within a segment, metres.

    It is 1.2 times the 80 % quantile of the deviations from the second most rigid partner, and at least a share of the
    body's size.
    """
    near = np.sort(np.where(np.eye(len(deviations), dtype=bool), np.inf, deviations), axis=1)[:, :2]
    nearest = np.where(np.isfinite(near[:, -1]), near[:, -1], near[:, 0])
    nearest = nearest[np.isfinite(nearest)]
    if not len(nearest):
        return SKIN_DEVIATION * body_size
    return max(UNIT_RATIO * float(np.quantile(nearest, 0.8)), SKIN_DEVIATION * body_size)


def cluster_markers(
    deviations: Float[np.ndarray, "M M"], unit: float, threshold: float = np.inf
) -> list[tuple[int, ...]]:
    """Partition markers by the shortest description: merge sets, and move single markers, while this shortens it.

    **Arguments:** `deviations` of the pairs, infinite where unknown; `unit` the usual deviation within a set; `threshold` the
    deviation that no pair of a set reaches.
    """
    excluded = ~(deviations < threshold) | ~np.isfinite(deviations)
    squares = np.where(excluded, EXCLUDED, (np.where(excluded, 0.0, deviations) / unit) ** 2)
    np.fill_diagonal(squares, 0.0)
    inside = np.eye(len(squares))
    for _ in range(4 * len(squares)):
        changed = _merge_best(squares, inside)
        if changed is None:
            changed = _move_best(squares, inside)
        if changed is None:
            break
        inside = changed[:, changed.any(0)]
    return [tuple(np.flatnonzero(column).tolist()) for column in inside.T]


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


def _merge_best(
    squares: Float[np.ndarray, "M M"], inside: Float[np.ndarray, "M K"]
) -> Float[np.ndarray, "M K"] | None:
    """Merge the two sets that save most; None where none do. Columns of `inside` are the sets' indicators."""
    sizes, totals = inside.sum(0), inside.T @ squares @ inside
    own = _costs(sizes, np.diag(totals))
    together = _costs(sizes[:, None] + sizes, np.diag(totals)[:, None] + np.diag(totals) + totals + totals.T)
    change = np.where(np.tri(len(sizes), dtype=bool), np.inf, together - own[:, None] - own)
    first, second = np.unravel_index(int(np.argmin(change)), change.shape)
    if not change[first, second] < -1e-9:
        return None
    merged = inside.copy()
    merged[:, first] += merged[:, second]
    merged[:, second] = 0.0
    return merged


def _move_best(
    squares: Float[np.ndarray, "M M"], inside: Float[np.ndarray, "M K"]
) -> Float[np.ndarray, "M L"] | None:
    """Move the marker that saves most to another set or a set of its own; None where none does."""
    wide = np.concatenate([inside, np.zeros((len(inside), 1))], 1)
    sizes, sums = wide.sum(0), squares @ wide
    totals = np.einsum("mk,mk->k", wide, sums)
    costs, owner = _costs(sizes, totals), wide.argmax(1)
    markers = np.arange(len(wide))
    left = _costs(sizes[owner] - 1, totals[owner] - 2 * sums[markers, owner]) - costs[owner]
    change = left[:, None] + _costs(sizes + 1, totals + 2 * sums) - costs
    change[markers, owner] = np.inf
    marker, target = np.unravel_index(int(np.argmin(change)), change.shape)
    if not change[marker, target] < -1e-9:
        return None
    wide[marker] = 0.0
    wide[marker, target] = 1.0
    return wide


def _costs(sizes: np.ndarray, totals: np.ndarray) -> np.ndarray:
    """Compute the description costs of sets from their sizes and the sums of squared deviations over their ordered pairs."""
    return SEGMENT_COSTS[np.minimum(sizes, 3).astype(int)] + totals / np.maximum(sizes - 1, 1)


def _mean_square_deviations(deviations: np.ndarray) -> np.ndarray:
    """Compute the mean square deviation of each marker from the others."""
    return (deviations**2).sum(1) / max(len(deviations) - 1, 1)
