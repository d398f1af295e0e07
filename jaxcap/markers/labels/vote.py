"""One label for each track, by the distances of all its frames from the predicted markers."""

import itertools
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from .tracks import Track

#: cost of a frame without a label, in squared gates; and of a change of the label within a track
NO_LABEL_COST, CHANGE_COST = 0.5, 3.0
#: factor of the cost of a given label
GIVEN_FACTOR = 0.25
#: a track is cut only if its best label costs more than this in a frame
MIN_CUT_COST = 0.1
#: number of labels that compete for a track
NUM_RIVALS = 6


class LabelledTrack(NamedTuple):
    """A track and its marker, -1 if it is of no marker."""

    track: Track
    marker: int


def vote_on_tracks(
    tracks: tuple[Track, ...],
    positions: Float[np.ndarray, "F N 3"],
    predicted: Float[np.ndarray, "F M 3"],
    known: Bool[np.ndarray, "F"],
    gates: Float[np.ndarray, "M"],
    given: Int[np.ndarray, "N"],
) -> list[LabelledTrack]:
    """Give each track the marker with the least sum of squared distances, or none.

    A track is cut where another label explains it better from there on. Frames in which no label explains it, between more frames
    with one label, are no evidence: a track has no jumps, so there the pose is wrong, as it may have been solved with a
    reflection near the marker. Two tracks never have one label
    in the same frame: the track with more evidence keeps it. Frames with no `known` pose are no evidence.
    """
    parts = []
    for track in tracks:
        costs = _frame_costs(track, positions, predicted, known, gates, int(given[track.column]))
        for runs in _cut_by_label(costs):
            begin, end = runs[0][0], runs[-1][1]
            gains = sum(NO_LABEL_COST * (b - a) - costs[a:b].sum(0) for a, b in runs)
            parts.append((Track(track.column, track.begin + begin, track.begin + end), gains))
    taken = np.zeros((len(predicted), len(gates)), bool)
    labelled = []
    for track, gains in sorted(parts, key=lambda part: -part[1].max()):
        marker = -1
        for candidate in np.argsort(-gains, kind="stable")[:NUM_RIVALS]:
            if gains[candidate] <= 0:
                break
            if not taken[track.frames, candidate].any():
                marker = int(candidate)
                taken[track.frames, candidate] = True
                break
        labelled.append(LabelledTrack(track, marker))
    return sorted(labelled, key=lambda one: (one.track.column, one.track.begin))


def _frame_costs(track: Track, positions, predicted, known, gates, given: int) -> Float[np.ndarray, "T M"]:
    """Compute the squared distances from all markers in gates, at most one; of frames without a pose the cost of no label."""
    away = positions[track.frames, track.column][:, None] - predicted[track.frames]
    costs = np.minimum(np.einsum("tma,tma->tm", away, away) / gates**2, 1.0)
    if given >= 0:
        costs[:, given] = np.where(costs[:, given] < 1, costs[:, given] * GIVEN_FACTOR, 1.0)
    return np.where(known[track.frames][:, None], costs, NO_LABEL_COST)


def _cut_by_label(costs: Float[np.ndarray, "T M"]) -> list[list[tuple[int, int]]]:
    """Cut a track into the pieces with the least cost of labels and changes (Viterbi 1967).

    Each piece is a list of its runs of frames that are evidence: several where it has no label between two equal ones.
    """
    frames = len(costs)
    if frames < 2 or costs.mean(0).min() < MIN_CUT_COST:
        return [[(0, frames)]]
    rivals = np.flatnonzero((costs < NO_LABEL_COST).sum(0) > CHANGE_COST)
    if not len(rivals):
        return [[(0, frames)]]
    local = np.concatenate([costs[:, rivals], np.full((frames, 1), NO_LABEL_COST)], 1)
    total = local[0].copy()
    origins = np.zeros(local.shape, int)
    for t in range(1, frames):
        best = int(total.argmin())
        change = total[best] + CHANGE_COST < total
        origins[t] = np.where(change, best, np.arange(local.shape[1]))
        total = np.where(change, total[best] + CHANGE_COST, total) + local[t]
    states = np.full(frames, int(total.argmin()))
    for t in range(frames - 1, 0, -1):
        states[t - 1] = origins[t, states[t]]
    edges = [0, *(1 + np.flatnonzero(np.diff(states))).tolist(), frames]
    return _join_equal(list(itertools.pairwise(edges)), states, local)


def _join_equal(
    runs: list[tuple[int, int]], states: Int[np.ndarray, "T"], costs: Float[np.ndarray, "T L"]
) -> list[list[tuple[int, int]]]:
    """Join the runs of one label with only a run without a label (the last column) between them.

    They are joined if the label is more likely than none for all of these frames together.
    """
    pieces = [[run] for run in runs[:1]]
    for run, before, label in zip(runs[1:], runs[:-1], states[[a for a, _ in runs[1:]]], strict=True):
        begin = pieces[-2][0][0] if len(pieces) > 1 else 0
        is_gap = states[before[0]] == costs.shape[1] - 1 and len(pieces) > 1 and states[begin] == label
        if is_gap and costs[begin : run[1], label].sum() < NO_LABEL_COST * (run[1] - begin):
            # the run without a label is inside of the piece
            pieces.pop()
            pieces[-1].append(run)
        else:
            pieces.append([run])
    return pieces
