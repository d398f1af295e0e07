"""Segments of one marker, which borrow a marker of a neighbour."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from .find_segments import COMPACTNESS, pair_deviations
from .pair_distances import median_distances
from .segment_sets import Segments

#: largest deviation of a borrowed marker, and of one that is attached to a segment, in units of the usual one
MAX_RATIO = 3.0
#: weight of a borrowed marker against one of the segment when a frame is fitted
BORROWED_WEIGHT = 0.5


class BorrowedMarkers(NamedTuple):
    """Markers, followed by copies of those that a segment of one marker borrows."""

    positions: Float[np.ndarray, "F N 3"]
    seen: Bool[np.ndarray, "F N"]
    segments: Segments


def borrow_markers(
    positions: Float[np.ndarray, "F M 3"],
    seen: Bool[np.ndarray, "F M"],
    segments: Segments,
) -> BorrowedMarkers:
    """Give each segment of one marker a copy of its most rigid partner in another segment.

    A marker next to a joint moves with both bones, and a partition puts it on one of them. The thigh of a gait model has
    one marker more, and keeps its frame by the marker at the knee and the joint at the hip.
    """
    if all(len(some) > 1 for some in segments.members):
        return BorrowedMarkers(positions, seen, segments)
    deviations, unit = pair_deviations(positions, seen)
    distances = median_distances(positions, seen)
    owner, members = segments.marker_segments, [list(some) for some in segments.members]
    copied: list[int] = []
    for segment, some in enumerate(segments.members):
        partner = find_partner(some[0], owner, deviations, distances, unit) if len(some) == 1 else None
        if partner is not None:
            members[segment].append(len(segments.weights) + len(copied))
            copied.append(partner)
    weights = np.concatenate([segments.weights, np.full(len(copied), BORROWED_WEIGHT)])
    return BorrowedMarkers(
        np.concatenate([positions, positions[:, copied]], 1),
        np.concatenate([seen, seen[:, copied]], 1),
        Segments(tuple(map(tuple, members)), weights, segments.names),
    )


def find_partner(
    marker: int,
    owner: Int[np.ndarray, "M"],
    deviations: Float[np.ndarray, "M M"],
    distances: Float[np.ndarray, "M M"],
    unit: float,
) -> int | None:
    """Find the near marker of another segment at the most constant distance; None where all vary by more than three times the usual.

    **Arguments:** `owner` the segment of each marker; `deviations` and median `distances` of the pairs, metres; `unit` the usual
    deviation.
    """
    away = deviations[marker] ** 2 + (COMPACTNESS * distances[marker]) ** 2
    allowed = (owner >= 0) & (owner != owner[marker]) & (deviations[marker] < MAX_RATIO * unit)
    allowed &= np.isfinite(away)
    return int(np.argmin(np.where(allowed, away, np.inf))) if allowed.any() else None
