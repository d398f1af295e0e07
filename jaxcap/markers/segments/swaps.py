"""Detection and correction of swapped marker labels."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from .gaps import find_runs
from .pair_distances import median_distances, pair_distance_ranges

#: number of partners that check a marker: those with the most constant distance from it
NUM_PARTNERS = 6
#: a distance is wrong if it is off by more than this multiple of its usual range, and than this, metres
MAX_RANGE_RATIO, MIN_DISTANCE_ERROR = 3.0, 0.015
#: a swap has to reduce the error to less than this share
MAX_REMAINING_ERROR = 0.4
#: two markers that jump onto each other are swapped if they jump back within this many frames
MAX_SWAP_FRAMES = 100
#: and if their jump is this multiple of their usual step
MIN_JUMP_RATIO = 8.0


class CorrectedMarkers(NamedTuple):
    """Markers with swaps undone."""

    positions: Float[np.ndarray, "F M 3"]
    seen: Bool[np.ndarray, "F M"]
    #: (frame, marker, marker) of each swap undone
    swaps: tuple[tuple[int, int, int], ...]
    messages: tuple[str, ...]


def correct_swaps(
    positions: Float[np.ndarray, "F M 3"], seen: Bool[np.ndarray, "F M"], labels: tuple[str, ...]
) -> CorrectedMarkers:
    """Undo swaps of two labels, frame by frame.

    A marker is an outlier in a frame if its distances from its usual partners are wrong. If two are
    outliers, and each fits at the other's position, they were swapped. Two markers with uninformative
    distances, as in a pair, are found by their jumps onto each other and back. A swap that lasts half of the
    take is not undone, as the labels then are a matter of convention.
    """
    positions, seen = np.array(positions, float), np.array(seen)
    undone = _correct_by_distance(positions, seen) + _correct_by_jumps(positions, seen)
    return CorrectedMarkers(positions, seen, tuple(sorted(undone)), tuple(_describe_swaps(undone, labels)))


def _correct_by_distance(positions: np.ndarray, seen: np.ndarray) -> list[tuple[int, int, int]]:
    medians, deviations = median_distances(positions, seen), pair_distance_ranges(positions, seen, 0.05)
    usual = np.where(np.isnan(deviations) | np.eye(len(deviations), dtype=bool), np.inf, deviations)
    partners = np.argsort(usual, axis=1, kind="stable")[:, :NUM_PARTNERS]
    rows = np.arange(len(usual))[:, None]
    # partners on another segment are no evidence
    trusted = usual[rows, partners] < np.maximum(4 * usual.min(1, keepdims=True), 2 * MIN_DISTANCE_ERROR)
    ranges = np.maximum(MAX_RANGE_RATIO * usual[rows, partners], MIN_DISTANCE_ERROR)
    expected = medians[rows, partners]

    def wrong(frame: int, marker: int, at: np.ndarray, shown: np.ndarray) -> float:
        """Compute the error of a marker's distances in units of the tolerance."""
        mine = partners[marker][trusted[marker] & shown[partners[marker]]]
        if len(mine) == 0:
            return 0.0
        where = [int(np.flatnonzero(partners[marker] == m)[0]) for m in mine]
        distances = np.linalg.norm(at[mine] - at[marker], axis=1)
        return float(np.median(np.abs(distances - expected[marker, where]) / ranges[marker, where]))

    distances = np.linalg.norm(positions[:, :, None] - positions[:, partners], axis=-1)
    vouched = seen[:, :, None] & seen[:, partners] & trusted
    off = np.where(vouched, np.abs(distances - expected) / np.where(trusted, ranges, 1.0), np.nan)
    scores = _nan_median(off)
    undone = []
    for frame in np.flatnonzero(((scores > 1) & seen).sum(1) >= 2).tolist():
        left = np.flatnonzero((scores[frame] > 1) & seen[frame]).tolist()
        while len(left) >= 2:
            at, shown = positions[frame], seen[frame]
            now = {i: wrong(frame, i, at, shown) for i in left}
            best, pair = np.inf, None
            for n, i in enumerate(left):
                for j in left[n + 1 :]:
                    exchanged = at.copy()
                    exchanged[[i, j]] = at[[j, i]]
                    after = [wrong(frame, k, exchanged, shown) for k in (i, j)]
                    before = [now[i], now[j]]
                    if (
                        max(after) < 1
                        and sum(after) < MAX_REMAINING_ERROR * sum(before)
                        and sum(after) < best
                    ):
                        best, pair = sum(after), (i, j)
            if pair is None:
                break
            positions[frame, list(pair)] = positions[frame, list(pair[::-1])]
            undone.append((frame, *pair))
            left = [i for i in left if i not in pair and wrong(frame, i, positions[frame], shown) > 1]
    return undone


def _correct_by_jumps(positions: np.ndarray, seen: np.ndarray) -> list[tuple[int, int, int]]:
    """Find and undo swaps between two jumps of a pair onto each other."""
    both = seen[1:] & seen[:-1]
    steps = np.where(both, np.linalg.norm(np.diff(positions, axis=0), axis=-1), 0.0)
    with np.errstate(invalid="ignore"):
        usual = np.array(
            [np.median(column[ok]) if ok.any() else 0.0 for column, ok in zip(steps.T, both.T, strict=True)]
        )
    large = (steps > np.maximum(MIN_JUMP_RATIO * usual, 0.5 * MIN_DISTANCE_ERROR)) & both
    jumps: dict[tuple[int, int], list[int]] = {}
    for frame in np.flatnonzero(large.sum(1) >= 2):
        some = np.flatnonzero(large[frame]).tolist()
        for n, i in enumerate(some):
            for j in some[n + 1 :]:
                current, following = positions[frame, [i, j]], positions[frame + 1, [j, i]]
                crossed = np.linalg.norm(following - current, axis=1)
                if (crossed < MAX_REMAINING_ERROR * steps[frame, [i, j]]).all():
                    jumps.setdefault((i, j), []).append(int(frame) + 1)
    undone = []
    for (i, j), frames in jumps.items():
        while len(frames) >= 2:
            begin, end = frames[:2]
            if end - begin > min(MAX_SWAP_FRAMES, len(positions) // 2):
                frames = frames[1:]
                continue
            positions[begin:end, [i, j]] = positions[begin:end, [j, i]]
            seen[begin:end, [i, j]] = seen[begin:end, [j, i]]
            undone += [(frame, i, j) for frame in range(begin, end)]
            frames = frames[2:]
    return undone


def _nan_median(values: np.ndarray) -> np.ndarray:
    """Compute the median over the last axis without NaN; zero where all are NaN."""
    count = (~np.isnan(values)).sum(-1)
    ordered = np.sort(values, axis=-1)
    low = np.take_along_axis(ordered, np.maximum((count - 1) // 2, 0)[..., None], -1)[..., 0]
    high = np.take_along_axis(ordered, np.minimum(count // 2, values.shape[-1] - 1)[..., None], -1)[..., 0]
    return np.where(count > 0, 0.5 * (low + high), 0.0)


def _describe_swaps(swaps: list[tuple[int, int, int]], labels: tuple[str, ...]) -> list[str]:
    frames: dict[tuple[int, int], list[int]] = {}
    for frame, i, j in swaps:
        frames.setdefault((min(i, j), max(i, j)), []).append(frame)
    messages = []
    for (i, j), some in sorted(frames.items(), key=lambda item: -len(item[1])):
        mask = np.zeros(max(some) + 1, bool)
        mask[some] = True
        spans = [f"{a}" if b - a == 1 else f"{a} to {b - 1}" for a, b in find_runs(mask)]
        shown = ", ".join(spans[:6]) + (", ..." if len(spans) > 6 else "")
        messages.append(
            f"The labels '{labels[i]}' and '{labels[j]}' were swapped in {len(some)} "
            f"frame{'s' if len(some) > 1 else ''} ({shown}); the swap is corrected."
        )
    return messages
