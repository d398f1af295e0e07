"""Labels that were exchanged in a trial of a known subject, undone by its poses."""

import itertools
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Int

from ...arguments import checked
from ...body.pose import Motion
from ...observe.markers import MarkerFrames
from ..motion.gap_filling import predicted_positions
from ..motion.label_matching import match_markers
from ..segments.swaps import describe_exchanges
from ..subject import Subject
from .tracks import cut_tracks

#: a track has a wrong label if its median distance from the prediction is above this, metres, and above this multiple of
#: the marker's usual distance; above the last, metres, always
MIN_WRONG, WRONG_RATIO, MAX_RIGHT = 0.03, 5.0, 0.08
#: another label fits within this share of the distance from the own one
MAX_SHARE = 0.4


class MendedLabels(NamedTuple):
    """Frames with exchanges undone."""

    frames: MarkerFrames
    #: the frames in which labels changed
    changed: Bool[np.ndarray, "F"]
    messages: tuple[str, ...]


@checked
def mend_labels(
    subject: Subject,
    motion: Motion,
    frames: MarkerFrames,
    *,
    lost: Bool[np.ndarray, "F"] | None = None,
) -> MendedLabels:
    """Undo exchanges of labels by the poses of a subject: of two, in cycles of several, and with a label that is not visible.

    The poses are robust: a few wrong labels do not move them. A track with a large distance from the prediction gets the
    label of the nearest prediction that no other track has in the same frames. A marker whose label another
    one needs, and that fits no label, has a gap.

    **Arguments:** `motion` solved from the `frames`; in its `lost` frames nothing is changed.
    """
    matched = match_markers(subject, frames)
    positions, seen = np.asarray(matched.positions, float), np.array(matched.seen)
    used = np.asarray(subject.weights) > 0
    seen &= used
    if lost is not None:
        seen &= ~np.asarray(lost)[:, None]
    predicted = np.asarray(predicted_positions(subject, motion), float)
    away = np.where(seen, np.linalg.norm(positions - predicted, axis=2), np.nan)
    some = np.asarray(seen.any(0))
    usual = np.zeros(len(some))
    usual[some] = np.nanmedian(away[:, some], axis=0)
    # a label that is wrong most of the time has a large usual distance
    bound = np.clip(WRONG_RATIO * usual, MIN_WRONG, MAX_RIGHT)
    source = _find_sources(positions, seen, predicted, away, bound, usual, frames.rate)
    changed = (source != np.arange(len(used))).any(1)
    if not changed.any():
        return MendedLabels(frames, changed, ())
    return MendedLabels(
        _apply(subject, frames, source),
        changed,
        describe_exchanges(source, _shown(source, seen), subject.labels),
    )


def _find_sources(positions, seen, predicted, away, bound, usual, rate: float) -> Int[np.ndarray, "F M"]:
    """Find the label that each marker has in the frames (F, M): its own, except in exchanges; -1 where it has none."""
    count = positions.shape[1]
    source = np.tile(np.arange(count), (len(positions), 1))
    pieces, good = [], seen.copy()
    for track in cut_tracks(positions, seen, rate):
        # an exchange of near markers is no jump: cut also where the distance changes from right to wrong
        wrong = away[track.frames, track.column] > bound[track.column]
        edges = [0, *(1 + np.flatnonzero(np.diff(wrong))).tolist(), len(wrong)]
        for a, b in itertools.pairwise(edges):
            if b > a and wrong[a]:
                pieces.append((track.column, track.begin + a, track.begin + b))
                good[track.begin + a : track.begin + b, track.column] = False
    options = []
    for column, begin, end in pieces:
        at = positions[begin:end, column]
        distances = np.median(np.linalg.norm(at[:, None] - predicted[begin:end], axis=2), axis=0)
        free = ~good[begin:end].any(0)
        fits = free & (distances < bound) & (distances < MAX_SHARE * distances[column])
        options += [
            (distances[label] / bound[label], column, begin, end, int(label))
            for label in np.flatnonzero(fits)
        ]
    taken, placed = good.copy(), set()
    for _, column, begin, end, label in sorted(options):
        if (column, begin) in placed or taken[begin:end, label].any():
            continue
        source[begin:end, label] = column
        taken[begin:end, label] = True
        placed.add((column, begin))
    for column, begin, end in pieces:
        if (column, begin) in placed:
            rows = np.arange(begin, end)
            # nothing took the place of a marker that moved away
            empty = source[rows, column] == column
            source[rows[empty], column] = -1
    return source


def _shown(source: Int[np.ndarray, "F M"], seen: Bool[np.ndarray, "F M"]) -> Bool[np.ndarray, "F M"]:
    return np.take_along_axis(seen, np.maximum(source, 0), 1) & (source >= 0)


def _apply(subject: Subject, frames: MarkerFrames, source: Int[np.ndarray, "F M"]) -> MarkerFrames:
    """Move the positions of the frames to the labels that they belong to."""
    place = {label: index for index, label in enumerate(frames.labels)}
    positions, seen = np.array(frames.positions), np.array(frames.visible)
    before = positions.copy(), seen.copy()
    for marker, label in enumerate(subject.labels):
        rows = np.flatnonzero(source[:, marker] != marker)
        if label not in place or not len(rows):
            continue
        # a point of a label that the file lacks stays where it is
        kept = [i < 0 or subject.labels[i] in place for i in source[rows, marker]]
        rows = rows[kept]
        from_columns = np.array(
            [place.get(subject.labels[i], -1) if i >= 0 else -1 for i in source[rows, marker]]
        )
        shown = from_columns >= 0
        seen[rows, place[label]] = shown & before[1][rows, from_columns]
        positions[rows, place[label]] = np.where(shown[:, None], before[0][rows, from_columns], 0.0)
    return MarkerFrames(positions, seen, frames.labels, frames.rate)
