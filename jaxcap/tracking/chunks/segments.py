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


class JoinedSegment(AbstractSegment):
    """Successive spans of segments."""

    def __init__(self, spans: Sequence[Span]):
        self.spans = tuple(spans)
        self.first, self.end = (self.spans[0].first, self.spans[-1].end) if spans else (0, 0)

    def frames(self, first: int, end: int) -> Iterator[TrackedFrame]:
        for span in self.between(first, end).spans:
            yield from span.segment.frames(span.first, span.end)

    def between(self, first: int, end: int) -> "JoinedSegment":
        """Return the part of the segment with numbers from `first` up to before `end`."""
        cut = [Span(max(span.first, first), min(span.end, end), span.segment) for span in self.spans]
        return JoinedSegment([span for span in cut if span.first < span.end])

    def replace_first(self, segment: AbstractSegment) -> "JoinedSegment":
        """Return the frames of `segment`, and after its end those of this one, if they follow without a gap."""
        own, rest = (
            Span(segment.first, segment.end, segment),
            self.between(segment.end, max(self.end, segment.end)),
        )
        return JoinedSegment([own, *(rest.spans if rest.first == segment.end else ())])


def last_frame(segment: AbstractSegment) -> TrackedFrame:
    """Return the last frame of a segment that is not empty."""
    return next(segment.frames(segment.end - 1, segment.end))
