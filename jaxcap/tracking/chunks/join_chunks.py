"""Chunks that are tracked at the same time, each from the state after the first frames, and that continue each other.

Tracking is sequential: a frame begins in the state of the frame before. Two runs whose states differ by a rounding error do not become
equal again where the cloud determines a pose weakly, such as that of fingers. So a sequence in chunks is another, exactly defined run. Some
frames before each chunk its pose is found anew, as after a gap in the recording, from the state after the first frames of the
sequence. The chunk continues from there if the pose before its first frame agrees with that of the chunk before. Otherwise it is tracked
again from the chunk before. Then most chunks depend only on the first frames, and can be tracked at the same time; the result depends on
the division, and not on the number of workers.
"""

import logging
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from ...body.pose import Pose
from ...body.skeleton import Skeleton
from ..judge_frame import TrackedFrame
from ..missing import has_begun
from ..track_frame import Tracker
from .agreement import compare_frames
from .division import WARM_UP, Chunk
from .segments import AbstractSegment, Span, last_frame
from .tasks import Task, begin_chunk

_LOG = logging.getLogger(__name__)

#: beginning of the names of tasks that track frames again
REPEATED = "again_"


class Outcome(NamedTuple):
    """The frames of a task, up to the first one that could not be tracked, and the sentence of the error; it has none if all are there."""

    segment: AbstractSegment | None
    error: str = ""


NO_FRAMES = Outcome(None)
#: runs tasks at the same time; yields the number and the outcome of each as it ends
RunTasks = Callable[[Sequence[Task]], Iterable[tuple[int, Outcome]]]


class Boundary(NamedTuple):
    """The boundary between a chunk and the one before it."""

    #: number of the first frame after it
    frame: int
    #: largest distance between the same joints of the two poses before it, metres; NaN where one of both is not good
    distance: float
    #: the frames after it do not depend on the chunk before
    independent: bool
    #: number of frames after it that were tracked again, from the chunk before
    num_repeated: int
    #: the frames after it continue those before it; not where these could not be tracked
    joined: bool


class Failure(NamedTuple):
    """Frames that could not be tracked."""

    first: int
    end: int
    #: a sentence
    message: str


class JoinedChunks(NamedTuple):
    """The frames of a sequence, and how its chunks were joined."""

    #: in order; frames that could not be tracked are in none
    spans: tuple[Span, ...]
    boundaries: tuple[Boundary, ...]
    failures: tuple[Failure, ...]


@dataclass
class _Part:
    """A chunk and its frames."""

    chunk: Chunk
    #: the first frames of the sequence, which only the first chunk has
    head: AbstractSegment | None = None
    #: tracked from the state after the first frames, and again from the chunk before
    own: Outcome = NO_FRAMES
    again: Outcome | None = None
    #: what the chunk before was when this one was compared with it
    compared: Outcome | None = None
    distance: float = np.nan
    #: how often it was tracked again
    num_again: int = 0

    @property
    def outcome(self) -> Outcome:
        return self.own if self.again is None else self.again

    @property
    def segments(self) -> list[AbstractSegment]:
        return [segment for segment in (self.head, self.outcome.segment) if segment is not None]

    @property
    def spans(self) -> list[Span]:
        """The frames of the chunk, in order."""
        spans = [Span(max(each.first, self.chunk.begin), each.end, each) for each in self.segments]
        return [span for span in spans if span.first < span.end]

    def frame(self, number: int) -> TrackedFrame | None:
        """Return a frame of the chunk, or one before it; None if it could not be tracked."""
        found = [segment for segment in self.segments if segment.first <= number < segment.end]
        return next(found[0].frames(number, number + 1)) if found else None


def join_chunks(
    tracker: Tracker,
    chunks: Sequence[Chunk],
    run: RunTasks,
    start: Pose | TrackedFrame | None = None,
) -> JoinedChunks:
    """Track all chunks by `run`.

    **Arguments:** `start` as of `track_frames`, for the first chunk.

    The first frames of the sequence are tracked first, and all chunks begin with their baseline. Then the chunks are tracked at the same
    time. One that does not agree with the last frame of the chunk before is then tracked again from there. If the first frames cannot be tracked,
    no chunk is.
    """
    parts = [_Part(chunk) for chunk in chunks]
    _LOG.info("tracking the first frames")
    (head,) = _run_all(run, [Task("head", chunks[0].begin, chunks[0].end, start, is_head=True)])
    parts[0].head = head.segment
    if head.error:
        spans = parts[0].spans
        failure = Failure(spans[-1].end if spans else chunks[0].begin, chunks[-1].end, head.error)
        return JoinedChunks(tuple(spans), tuple(_boundaries(parts)), (failure,))
    _track_all(tracker, parts, run, start)
    while todo := _compare_chunks(tracker.body.skeleton, parts):
        _LOG.info("tracking %d chunks again, from the chunk before", len(todo))
        tasks = [_repeat(parts[number - 1], parts[number]) for number in todo]
        for number, outcome in zip(todo, _run_all(run, tasks), strict=True):
            parts[number].again = outcome
    spans = [span for part in parts for span in part.spans]
    return JoinedChunks(tuple(spans), tuple(_boundaries(parts)), tuple(_failures(parts)))


def _track_all(
    tracker: Tracker, parts: Sequence[_Part], run: RunTasks, start: Pose | TrackedFrame | None
) -> None:
    """Track each chunk from the state after the first frames."""
    first, *others = (part.chunk for part in parts)
    begun, known = first.begin, start
    if parts[0].spans:
        begun, known = parts[0].spans[-1].end, last_frame(parts[0].segments[-1])
    tasks = {}
    if begun < first.end:
        tasks[0] = Task("chunk_0", begun, first.end, known)
    if isinstance(known, TrackedFrame):
        # before a person is seen, nothing is known
        known = begin_chunk(tracker, known) if has_begun(known) else start
    for number, chunk in enumerate(others, 1):
        earlier = min(WARM_UP, chunk.begin - first.begin)
        tasks[number] = Task(f"chunk_{number}", chunk.begin - earlier, chunk.end, known, earlier)
    _LOG.info("tracking the chunks")
    for number, outcome in zip(tasks, _run_all(run, list(tasks.values())), strict=True):
        parts[number].own = outcome


def _compare_chunks(skeleton: Skeleton, parts: Sequence[_Part]) -> list[int]:
    """Compare chunks with the ones before them, and list those that are to be tracked again from there.

    A chunk is compared again if the one before has changed. It is not listed if that one is: it may not have to be tracked again.
    """
    todo = list[int]()
    for number, (before, part) in enumerate(pairwise(parts), 1):
        if number - 1 in todo or part.compared is before.outcome:
            continue
        part.compared, part.again, part.distance = before.outcome, None, np.nan
        last, own = before.frame(before.chunk.end - 1), part.frame(part.chunk.begin - 1)
        if last is None:
            continue
        agree = False
        if own is not None:
            part.distance, agree = compare_frames(skeleton, last, own)
        if not agree:
            todo.append(number)
    return todo


def _repeat(before: _Part, part: _Part) -> Task:
    """Make the task that tracks a chunk again, from the last frame of the one before."""
    part.num_again += 1
    begin, end = part.chunk
    return Task(f"{REPEATED}{begin}_{part.num_again}", begin, end, before.frame(begin - 1))


def _run_all(run: RunTasks, tasks: Sequence[Task]) -> list[Outcome]:
    """Run tasks; return their outcomes in their order."""
    outcomes = dict(run(tasks)) if tasks else {}
    return [outcomes[number] for number in range(len(tasks))]


def _boundaries(parts: Sequence[_Part]) -> Iterator[Boundary]:
    """Describe the boundary before each chunk but the first one."""
    for before, part in pairwise(parts):
        begin, end = part.chunk
        repeated, joined = part.again is not None, before.frame(begin - 1) is not None
        yield Boundary(begin, part.distance, not repeated, end - begin if repeated else 0, joined)


def _failures(parts: Sequence[_Part]) -> Iterator[Failure]:
    """List the frames that could not be tracked."""
    for part in parts:
        if part.outcome.error:
            spans = part.spans
            yield Failure(spans[-1].end if spans else part.chunk.begin, part.chunk.end, part.outcome.error)
