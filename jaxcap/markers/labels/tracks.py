"""Tracks: pieces of trajectories without gaps and without jumps, each of one marker at most."""

import itertools
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from ..segments.gaps import find_runs

#: a step that differs from the previous one by more than this, metres, and than this acceleration explains,
#: metres per second squared, is a jump to another marker
MIN_JUMP, MAX_ACCELERATION = 0.03, 200.0


class Track(NamedTuple):
    """Frames `begin` to `end`, exclusive, of one column of the frames."""

    column: int
    begin: int
    end: int

    @property
    def frames(self) -> slice:
        """The frames of the track."""
        return slice(self.begin, self.end)


def cut_tracks(
    positions: Float[np.ndarray, "F N 3"], seen: Bool[np.ndarray, "F N"], rate: float
) -> tuple[Track, ...]:
    """Cut trajectories at their gaps, and where they jump onto another marker."""
    tracks = []
    limit = MIN_JUMP + MAX_ACCELERATION / rate**2
    for column in range(positions.shape[1]):
        for begin, end in find_runs(seen[:, column]):
            at = positions[begin:end, column]
            steps = np.diff(at, axis=0)
            # a jump is a change of velocity forwards and backwards in time; at the ends only one is known
            changes = np.linalg.norm(np.diff(steps, axis=0), axis=1)
            before = np.concatenate([[np.inf], changes])[: len(steps)]
            after = np.concatenate([changes, [np.inf]])[: len(steps)]
            far = np.linalg.norm(steps, axis=1) > limit
            jumps = np.flatnonzero(far & (np.minimum(before, after) > limit)) + 1
            edges = [begin, *(begin + jumps).tolist(), end]
            tracks += [Track(column, a, b) for a, b in itertools.pairwise(edges)]
    return tuple(tracks)


def tracks_by_frame(tracks: tuple[Track, ...], shape: tuple[int, int]) -> Int[np.ndarray, "F N"]:
    """Give the number of the track in each frame and column, -1 where there is none."""
    numbers = np.full(shape, -1)
    for number, track in enumerate(tracks):
        numbers[track.frames, track.column] = number
    return numbers
