"""Detection and correction of swapped marker labels."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from .gaps import runs
from .pair_distances import median_distances, pair_deviations

#: number of partners that check a marker: those with the most constant distance from it
PARTNERS = 6
#: a distance is wrong if it is off by more than this multiple of its usual range, and than this, metres
RANGES, LEAST = 3.0, 0.015
#: a swap has to reduce the error to less than this share
MENDED = 0.4
#: two markers that jump onto each other are swapped if they jump back within this many frames
LONGEST = 100
#: and if their jump is this multiple of their usual step
STEPS = 8.0


class Mended(NamedTuple):
    """Markers with swaps undone."""

    places: Float[np.ndarray, "F M 3"]
    seen: Bool[np.ndarray, "F M"]
    #: (frame, marker, marker) of each swap undone
    exchanges: tuple[tuple[int, int, int], ...]
    told: tuple[str, ...]


def mend_swaps(
    places: Float[np.ndarray, "F M 3"], seen: Bool[np.ndarray, "F M"], labels: tuple[str, ...]
) -> Mended:
    """Undo swaps of two labels, frame by frame.

    A marker is an outlier in a frame if its distances from its usual partners are wrong. If two are
    outliers, and each fits at the other's position, they were swapped. Two markers with uninformative
    distances, as in a pair, are found by their jumps onto each other and back. A swap that lasts half of the
    take is not undone, as the labels then are a matter of convention.
    """
    places, seen = np.array(places, float), np.array(seen)
    undone = _by_distance(places, seen) + _by_jumps(places, seen)
    return Mended(places, seen, tuple(sorted(undone)), tuple(_sentences(undone, labels)))


def _by_distance(places: np.ndarray, seen: np.ndarray) -> list[tuple[int, int, int]]:
    medians, deviations = median_distances(places, seen), pair_deviations(places, seen, 0.05)
    usual = np.where(np.isnan(deviations) | np.eye(len(deviations), dtype=bool), np.inf, deviations)
    partners = np.argsort(usual, axis=1, kind="stable")[:, :PARTNERS]
    rows = np.arange(len(usual))[:, None]
    # partners on another segment are no evidence
    trusted = usual[rows, partners] < np.maximum(4 * usual.min(1, keepdims=True), 2 * LEAST)
    ranges = np.maximum(RANGES * usual[rows, partners], LEAST)
    expected = medians[rows, partners]

    def wrong(frame: int, marker: int, at: np.ndarray, shown: np.ndarray) -> float:
        """Compute the error of a marker's distances in units of the tolerance."""
        mine = partners[marker][trusted[marker] & shown[partners[marker]]]
        if len(mine) == 0:
            return 0.0
        where = [int(np.flatnonzero(partners[marker] == m)[0]) for m in mine]
        distances = np.linalg.norm(at[mine] - at[marker], axis=1)
        return float(np.median(np.abs(distances - expected[marker, where]) / ranges[marker, where]))

    distances = np.linalg.norm(places[:, :, None] - places[:, partners], axis=-1)
    vouched = seen[:, :, None] & seen[:, partners] & trusted
    off = np.where(vouched, np.abs(distances - expected) / np.where(trusted, ranges, 1.0), np.nan)
    scores = _median(off)
    undone = []
    for frame in np.flatnonzero(((scores > 1) & seen).sum(1) >= 2).tolist():
        left = np.flatnonzero((scores[frame] > 1) & seen[frame]).tolist()
        while len(left) >= 2:
            at, shown = places[frame], seen[frame]
            now = {i: wrong(frame, i, at, shown) for i in left}
            best, pair = np.inf, None
            for n, i in enumerate(left):
                for j in left[n + 1 :]:
                    exchanged = at.copy()
                    exchanged[[i, j]] = at[[j, i]]
                    after = [wrong(frame, k, exchanged, shown) for k in (i, j)]
                    before = [now[i], now[j]]
                    if max(after) < 1 and sum(after) < MENDED * sum(before) and sum(after) < best:
                        best, pair = sum(after), (i, j)
            if pair is None:
                break
            places[frame, list(pair)] = places[frame, list(pair[::-1])]
            undone.append((frame, *pair))
            left = [i for i in left if i not in pair and wrong(frame, i, places[frame], shown) > 1]
    return undone


def _by_jumps(places: np.ndarray, seen: np.ndarray) -> list[tuple[int, int, int]]:
    """Find and undo swaps between two jumps of a pair onto each other."""
    both = seen[1:] & seen[:-1]
    steps = np.where(both, np.linalg.norm(np.diff(places, axis=0), axis=-1), 0.0)
    with np.errstate(invalid="ignore"):
        usual = np.array(
            [np.median(column[ok]) if ok.any() else 0.0 for column, ok in zip(steps.T, both.T, strict=True)]
        )
    large = (steps > np.maximum(STEPS * usual, 0.5 * LEAST)) & both
    jumps: dict[tuple[int, int], list[int]] = {}
    for frame in np.flatnonzero(large.sum(1) >= 2):
        some = np.flatnonzero(large[frame]).tolist()
        for n, i in enumerate(some):
            for j in some[n + 1 :]:
                here, there = places[frame, [i, j]], places[frame + 1, [j, i]]
                crossed = np.linalg.norm(there - here, axis=1)
                if (crossed < MENDED * steps[frame, [i, j]]).all():
                    jumps.setdefault((i, j), []).append(int(frame) + 1)
    undone = []
    for (i, j), frames in jumps.items():
        while len(frames) >= 2:
            begin, end = frames[:2]
            if end - begin > min(LONGEST, len(places) // 2):
                frames = frames[1:]
                continue
            places[begin:end, [i, j]] = places[begin:end, [j, i]]
            seen[begin:end, [i, j]] = seen[begin:end, [j, i]]
            undone += [(frame, i, j) for frame in range(begin, end)]
            frames = frames[2:]
    return undone


def _median(values: np.ndarray) -> np.ndarray:
    """Compute the median over the last axis without NaN; zero where all are NaN."""
    count = (~np.isnan(values)).sum(-1)
    ordered = np.sort(values, axis=-1)
    low = np.take_along_axis(ordered, np.maximum((count - 1) // 2, 0)[..., None], -1)[..., 0]
    high = np.take_along_axis(ordered, np.minimum(count // 2, values.shape[-1] - 1)[..., None], -1)[..., 0]
    return np.where(count > 0, 0.5 * (low + high), 0.0)


def _sentences(undone: list[tuple[int, int, int]], labels: tuple[str, ...]) -> list[str]:
    frames: dict[tuple[int, int], list[int]] = {}
    for frame, i, j in undone:
        frames.setdefault((min(i, j), max(i, j)), []).append(frame)
    told = []
    for (i, j), some in sorted(frames.items(), key=lambda item: -len(item[1])):
        mask = np.zeros(max(some) + 1, bool)
        mask[some] = True
        spans = [f"{a}" if b - a == 1 else f"{a} to {b - 1}" for a, b in runs(mask)]
        shown = ", ".join(spans[:6]) + (", ..." if len(spans) > 6 else "")
        told.append(
            f"The labels '{labels[i]}' and '{labels[j]}' were swapped in {len(some)} "
            f"frame{'s' if len(some) > 1 else ''} ({shown}); the swap is corrected."
        )
    return told
