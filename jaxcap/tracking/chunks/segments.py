"""Successive tracked frames, in memory or elsewhere."""

import abc
from collections.abc import Iterator, Sequence
from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..judge_frame import TrackedFrame


class AbstractSegment(abc.ABC):
    """Successive tracked frames, with their numbers in the sequence."""

    #: number of the first frame, and of the one after the last frame
    first: int
    end: int

    @abc.abstractmethod
    def frames(self, first: int, end: int) -> Iterator[TrackedFrame]:
        """Iterate over the frames of some numbers, which the segment has."""


class StackedFrames(AbstractSegment):
    """Frames in memory, stacked as NumPy arrays: a JAX array has an overhead of a kilobyte."""

    def __init__(self, first: int, frames: Sequence[TrackedFrame]):
        self.first, self.end = first, first + len(frames)
        # the types of the leaves, of which some are numbers of Python
        self._like = frames[0] if frames else None
        self._stacked = (
            jax.tree.map(lambda *leaves: np.stack([np.asarray(leaf) for leaf in leaves]), *frames)
            if frames
            else None
        )

    def frames(self, first: int, end: int) -> Iterator[TrackedFrame]:
        def leaf_of(like, stacked, row):
            return jnp.asarray(stacked[row], like.dtype) if eqx.is_array(like) else type(like)(stacked[row])

        for row in range(first - self.first, end - self.first):
            yield jax.tree.map(partial(leaf_of, row=row), self._like, self._stacked)


class Span(NamedTuple):
    """The frames of a segment from one number up to before another one."""

    first: int
    end: int
    segment: AbstractSegment

    def frames(self) -> Iterator[TrackedFrame]:
        """Iterate over the frames."""
        return self.segment.frames(self.first, self.end)


def last_frame(segment: AbstractSegment) -> TrackedFrame:
    """Return the last frame of a segment that is not empty."""
    return next(segment.frames(segment.end - 1, segment.end))
