"""Detection and correction of exchanged marker labels, before a subject is known."""

import itertools
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from ...errors import join_names
from ...geometry.sampling import even_indices
from .gaps import find_runs, list_runs
from .pair_distances import median_distances, pair_distance_ranges

#: number of partners that check a marker: those with the most constant distance from it
NUM_PARTNERS = 6
#: a distance is wrong if it is off by more than this multiple of its usual range, and than this, metres
MAX_RANGE_RATIO, MIN_DISTANCE_ERROR = 3.0, 0.015
#: another label has to reduce the error to less than this share, and to less than this many tolerances
MAX_REMAINING_ERROR, MAX_NEW_ERROR = 0.4, 0.5
#: two markers that jump onto each other are exchanged if they jump back within this many frames
MAX_SWAP_FRAMES = 100
#: a step that is this multiple of a marker's usual step is a jump
MIN_JUMP_RATIO = 8.0
#: share of frames at each end that the usual range of a distance omits; the label may be wrong in these
TRIMMED = 0.15
#: number of exchanges that have a sentence of their own, those of the most frames
MAX_DESCRIBED = 10
#: number of frames of a piece of a trajectory in which its distances are compared
FRAMES_COMPARED = 20


class CorrectedMarkers(NamedTuple):
    """Markers with exchanges undone."""

    positions: Float[np.ndarray, "F M 3"]
    seen: Bool[np.ndarray, "F M"]
    #: (frame, label, other label) of each marker that had the other label, and for an exchange of two once
    swaps: tuple[tuple[int, int, int], ...]
    #: the label that each marker had
    source: Int[np.ndarray, "F M"]
    messages: tuple[str, ...]


class _Piece(NamedTuple):
    """Frames `begin` to `end`, exclusive, of the trajectory with a label."""

    label: int
    begin: int
    end: int


def correct_swaps(
    positions: Float[np.ndarray, "F M 3"], seen: Bool[np.ndarray, "F M"], labels: tuple[str, ...]
) -> CorrectedMarkers:
    """Undo exchanges of labels: of two, in cycles of several, and with a label whose marker is not visible.

    Trajectories are cut at their jumps. A piece is suspicious if its distances from its usual partners are
    wrong. It gets the label whose partners fit it, if no other piece has this label in the same frames. Two
    markers with uninformative distances, as in a pair, are found by their jumps onto each other and back. An
    exchange that lasts half of the take is not undone, as the labels then are a matter of convention.
    """
    positions, seen = np.array(positions, float), np.array(seen)
    steps = _Steps(positions, seen)
    source = np.tile(np.arange(positions.shape[1]), (len(positions), 1))
    for piece, label in _relabelled(positions, seen, _Partners(positions, seen), steps).items():
        source[piece.begin : piece.end, label] = piece.label
    _correct_by_jumps(positions, seen, source, steps)
    moved = np.take_along_axis(positions, source[..., None], 1)
    shown = np.take_along_axis(seen, source, 1)
    # a label that moved to another marker is visible nowhere else
    count = np.zeros_like(source)
    np.add.at(count, (np.arange(len(source))[:, None], source), 1)
    own = source == np.arange(source.shape[1])
    shown &= ~(own & (count > 1))
    moved = np.where(shown[..., None], moved, 0.0)
    return CorrectedMarkers(
        moved, shown, list_exchanges(source, shown), source, describe_exchanges(source, shown, labels)
    )


class _Partners:
    """The distances of each marker from its partners, and the tolerances of these."""

    def __init__(self, positions: np.ndarray, seen: np.ndarray):
        medians, deviations = (
            median_distances(positions, seen),
            pair_distance_ranges(positions, seen, TRIMMED),
        )
        usual = np.where(np.isnan(deviations) | np.eye(len(deviations), dtype=bool), np.inf, deviations)
        self.index = np.argsort(usual, axis=1, kind="stable")[:, :NUM_PARTNERS]
        rows = np.arange(len(usual))[:, None]
        # partners on another segment are no evidence
        nearest = usual.min(1, keepdims=True)
        self.trusted = usual[rows, self.index] < np.maximum(4 * nearest, 2 * MIN_DISTANCE_ERROR)
        ranges = np.maximum(MAX_RANGE_RATIO * usual[rows, self.index], MIN_DISTANCE_ERROR)
        self.ranges = np.where(self.trusted, ranges, 1.0)
        self.expected = medians[rows, self.index]

    def errors(
        self, label: int, at: Float[np.ndarray, "F 3"], positions: Float[np.ndarray, "F M 3"], valid
    ) -> Float[np.ndarray, "F"]:
        """Compute the median error of a label's distances at points, in tolerances; NaN without `valid` partners."""
        index = self.index[label]
        away = np.linalg.norm(positions[:, index] - at[:, None], axis=2)
        off = np.abs(away - self.expected[label]) / self.ranges[label]
        return _nan_median(np.where(valid[:, index] & self.trusted[label], off, np.nan))


class _Steps:
    """The steps of markers between frames, and those that are jumps."""

    def __init__(self, positions: np.ndarray, seen: np.ndarray):
        self.both = seen[1:] & seen[:-1]
        self.lengths = np.where(self.both, np.linalg.norm(np.diff(positions, axis=0), axis=-1), 0.0)
        usual = _nan_median(np.where(self.both, self.lengths, np.nan).T)
        least = np.maximum(MIN_JUMP_RATIO * np.nan_to_num(usual), 0.5 * MIN_DISTANCE_ERROR)
        self.jumps = (self.lengths > least) & self.both

    def pieces(self, seen: Bool[np.ndarray, "F M"]) -> list[_Piece]:
        """Cut trajectories at gaps and jumps."""
        found = []
        for label in range(seen.shape[1]):
            for begin, end in find_runs(seen[:, label]):
                cuts = begin + 1 + np.flatnonzero(self.jumps[begin : end - 1, label])
                edges = [begin, *cuts.tolist(), end]
                found += [_Piece(label, *pair) for pair in itertools.pairwise(edges)]
        return found


def _relabelled(positions, seen, partners: _Partners, steps: _Steps) -> dict[_Piece, int]:
    """Find the pieces with wrong labels, and their labels."""
    count = positions.shape[1]
    own = [partners.errors(label, positions[:, label], positions, seen) for label in range(count)]
    suspicious, good = [], seen.copy()
    for piece in steps.pieces(seen):
        if (error := _median(own[piece.label][piece.begin : piece.end])) > 1:
            suspicious.append((piece, error))
            good[piece.begin : piece.end, piece.label] = False
    options = []
    for piece, error in suspicious:
        frames = piece.begin + even_indices(piece.end - piece.begin, FRAMES_COMPARED)
        at = positions[frames, piece.label]
        for label in range(count):
            # others have this label: good ones keep it
            if label == piece.label or good[frames, label].mean() > 0.5:
                continue
            after = _median(
                _error_elsewhere(
                    partners, label, piece.label, at, positions[frames], seen[frames], good[frames]
                )
            )
            if after < min(MAX_NEW_ERROR, MAX_REMAINING_ERROR * error):
                options.append((after, -len(frames), piece, label))
    found: dict[_Piece, int] = {}
    taken = good.copy()
    for _, _, piece, label in sorted(options):
        frames = slice(piece.begin, piece.end)
        long = piece.end - piece.begin > len(positions) // 2
        if piece in found or taken[frames, label].any() or long:
            continue
        found[piece] = label
        taken[frames, label] = True
    return found


def _error_elsewhere(
    partners: _Partners, label: int, old: int, at, positions, seen, good
) -> Float[np.ndarray, "F"]:
    """Compute the errors of a label at the points that have another one.

    Partners with suspicious labels count only where fewer than two others are visible.
    """
    index = partners.index[label]
    few = (good[:, index] & partners.trusted[label]).sum(1) < 2
    others = seen.copy()
    others[:, [label, old]] = False
    return partners.errors(label, at, positions, np.where(few[:, None], others, good & others))


def _correct_by_jumps(positions, seen, source: Int[np.ndarray, "F M"], steps: _Steps) -> None:
    """Undo exchanges between two jumps of a pair onto each other, unless distances did."""
    jumps: dict[tuple[int, int], list[int]] = {}
    for frame in np.flatnonzero(steps.jumps.sum(1) >= 2):
        some = np.flatnonzero(steps.jumps[frame]).tolist()
        for n, i in enumerate(some):
            for j in some[n + 1 :]:
                current, following = positions[frame, [i, j]], positions[frame + 1, [j, i]]
                crossed = np.linalg.norm(following - current, axis=1)
                if (crossed < MAX_REMAINING_ERROR * steps.lengths[frame, [i, j]]).all():
                    jumps.setdefault((i, j), []).append(int(frame) + 1)
    for (i, j), frames in jumps.items():
        while len(frames) >= 2:
            begin, end = frames[:2]
            if end - begin > min(MAX_SWAP_FRAMES, len(positions) // 2):
                frames = frames[1:]
                continue
            pair = np.array([i, j])
            if (source[begin:end, pair] == pair).all():
                source[begin:end, pair] = pair[::-1]
            frames = frames[2:]


def list_exchanges(
    source: Int[np.ndarray, "F M"], shown: Bool[np.ndarray, "F M"]
) -> tuple[tuple[int, int, int], ...]:
    """List (frame, label, label that its marker had); an exchange of two is listed once."""
    found = []
    for frame, label in np.argwhere((source != np.arange(source.shape[1])) & shown).tolist():
        other = int(source[frame, label])
        if not (other < label and source[frame, other] == label and shown[frame, other]):
            found.append((frame, label, other))
    return tuple(found)


def describe_exchanges(
    source: Int[np.ndarray, "F M"], shown: Bool[np.ndarray, "F M"], labels: tuple[str, ...]
) -> tuple[str, ...]:
    """Describe exchanges of labels, with their frames: `source (F, M)` the label that each marker had."""
    frames: dict[tuple[int, ...], list[int]] = {}
    changed = source != np.arange(source.shape[1])
    for frame in np.flatnonzero(changed.any(1)).tolist():
        for chain in _chains(source[frame], np.flatnonzero(changed[frame] & shown[frame]).tolist()):
            frames.setdefault(chain, []).append(frame)
    messages = []
    ordered = sorted(frames.items(), key=lambda item: -len(item[1]))
    listed, others = ordered[:MAX_DESCRIBED], ordered[MAX_DESCRIBED:]
    for chain, some in listed:
        mask = np.zeros(max(some) + 1, bool)
        mask[some] = True
        where = f"in {len(some)} frame{'s' if len(some) > 1 else ''} ({list_runs(mask)})"
        names = [f"'{labels[i]}'" for i in chain[:-1]]
        if chain[-1] != chain[0]:
            messages.append(
                f"The label {', '.join(names)} was on the marker '{labels[chain[-1]]}' {where}; it is corrected."
                if len(names) == 1
                else f"The labels {', '.join(names)} were on the next marker, the last on '{labels[chain[-1]]}', {where}; this is corrected."
            )
        elif len(names) == 2:
            messages.append(
                f"The labels {names[0]} and {names[1]} were swapped {where}; the swap is corrected."
            )
        else:
            messages.append(
                f"The labels {join_names(names)} were exchanged in a cycle {where}; the exchange is corrected."
            )
    if others:
        count = len({frame for _, some in others for frame in some})
        messages.append(
            f"Labels were also exchanged in {len(others)} further group{'s' if len(others) > 1 else ''} of markers, in {count} "
            f"frame{'s' if count > 1 else ''}; all are corrected."
        )
    return tuple(messages)


def _chains(source: Int[np.ndarray, "M"], changed: Iterable[int]) -> list[tuple[int, ...]]:
    """Follow labels to the markers that they were on: cycles, which end with their first label, and open chains."""
    # label -> the marker that it was on
    onto = {int(source[label]): label for label in changed}
    chains = []
    starts = sorted(set(onto) - set(onto.values())) + sorted(set(onto) & set(onto.values()))
    while starts:
        chain = [starts[0]]
        while chain[-1] in onto and (len(chain) == 1 or chain[-1] != chain[0]):
            chain.append(onto.pop(chain[-1]))
        if len(chain) > 1:
            chains.append(tuple(chain))
        starts = [start for start in starts if start in onto]
    return chains


def _median(values: Float[np.ndarray, "F"]) -> float:
    """Compute the median without NaN; NaN where all are."""
    known = values[~np.isnan(values)]
    return float(np.median(known)) if len(known) else np.nan


def _nan_median(values: Float[np.ndarray, "R N"]) -> Float[np.ndarray, "R"]:
    """Compute the median over the last axis without NaN; NaN where all are."""
    count = (~np.isnan(values)).sum(-1)
    ordered = np.sort(values, axis=-1)
    low = np.take_along_axis(ordered, np.maximum((count - 1) // 2, 0)[..., None], -1)[..., 0]
    high = np.take_along_axis(ordered, np.minimum(count // 2, values.shape[-1] - 1)[..., None], -1)[..., 0]
    return np.where(count > 0, 0.5 * (low + high), np.nan)
