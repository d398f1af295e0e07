"""Chunks that are tracked at the same time, each from a search of its own, and that continue each other.

Tracking is sequential: a frame begins in the state of the frame before. Two runs that begin in states which differ by a rounding error do not become
equal again where the cloud determines a pose weakly, such as that of fingers. So a sequence in chunks is another, exactly defined run: before the first
frame of each chunk a search without memory finds the pose of the frame before. Tracking continues from there if the frame as it was tracked
agrees with it, otherwise from the frame as it was tracked. Then most chunks depend on no other one, and can be tracked at the same time;
the result depends on the division only, and not on the number of workers.
"""

import logging
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from ...body.pose import Pose
from ...body.skeleton import Skeleton
from ..judge_frame import TrackedFrame
from .agreement import agrees, pose_distance
from .division import Chunk
from .segments import AbstractSegment, last_frame
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
    #: largest distance between the same joints of the frame before it as it was tracked and as a search found it, metres; NaN where
    #: one of both is not good
    distance: float
    #: the frames after it begin at the pose of the search
    searched: bool
    #: number of frames after it that were tracked again, as both poses do not agree
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
    segments: tuple[AbstractSegment, ...]
    boundaries: tuple[Boundary, ...]
    failures: tuple[Failure, ...]


@dataclass
class _Part:
    """Successive chunks that begin at the pose of one search: all but the first one have none."""

    begin: int
    end: int
    #: of the frame before; None at the beginning of the sequence
    found: TrackedFrame | None
    #: tracked from the pose of the search, and again from the part before
    own: Outcome = NO_FRAMES
    again: Outcome | None = None
    #: the beginning of the sequence, before the first frame of both
    head: list[AbstractSegment] = field(default_factory=list)
    #: what the part before was when this one was joined to it, and the distance between its last frame and the search
    joined_to: Outcome | None = None
    distance: float = np.nan
    #: how often it was tracked again
    num_again: int = 0

    @property
    def outcome(self) -> Outcome:
        return self.own if self.again is None else self.again

    @property
    def segments(self) -> list[AbstractSegment]:
        own = self.outcome.segment
        return [part for part in (*self.head, own) if part is not None and part.first < part.end]

    @property
    def last(self) -> TrackedFrame | None:
        """The last frame; None if it could not be tracked."""
        segments = self.segments
        return last_frame(segments[-1]) if segments and segments[-1].end == self.end else None


def join_chunks(
    skeleton: Skeleton,
    chunks: Sequence[Chunk],
    run: RunTasks,
    start: Pose | TrackedFrame | None = None,
) -> JoinedChunks:
    """Track all chunks by `run`.

    **Arguments:** `start` as of `track_frames`, for the first chunk.

    The first frames of the sequence are tracked while the poses before the first frames of the other chunks are searched for: all chunks have the
    baseline of the beginning. Then the chunks are tracked at the same time, those without a good pose together with the chunk before. A chunk whose search does not
    agree with the last frame of the chunk before is then tracked again from there.
    """
    parts = _track_all(chunks, run, start)
    while todo := _find_repeated(skeleton, parts):
        _LOG.info("tracking %d chunks again, from the chunk before", len(todo))
        tasks = [_repeat(parts[number - 1], parts[number]) for number in todo]
        for number, outcome in zip(todo, _run_all(run, tasks), strict=True):
            parts[number].again = outcome
    segments = [segment for part in parts for segment in part.segments]
    return JoinedChunks(tuple(segments), tuple(_boundaries(chunks, parts)), tuple(_failures(parts)))


def _track_all(chunks: Sequence[Chunk], run: RunTasks, start: Pose | TrackedFrame | None) -> list[_Part]:
    """Track each chunk from its own search."""
    first, *others = chunks
    tasks = [Task("head", first.begin, first.end, start, is_head=True)]
    tasks += [
        Task(f"start_{k}", chunk.begin - 1, chunk.begin, None, is_search=True)
        for k, chunk in enumerate(others, 1)
    ]
    _LOG.info("tracking the first frames, and searching for the first pose of each chunk")
    head, *searches = _run_all(run, tasks)
    parts = [_Part(first.begin, first.end, None)]
    for chunk, search in zip(others, searches, strict=True):
        frame = None if search.segment is None or search.error else last_frame(search.segment)
        if frame is None or frame.verdict != "good":
            parts[-1].end = chunk.end
        else:
            parts.append(_Part(chunk.begin, chunk.end, frame))
    known = start if isinstance(start, TrackedFrame) else None
    begin = first.begin
    if head.segment is not None and head.segment.first < head.segment.end:
        parts[0].head, begin, known = [head.segment], head.segment.end, last_frame(head.segment)
    tasks, todo = [], []
    for number, part in enumerate(parts):
        if number:
            assert part.found is not None
            found = part.found if known is None else begin_chunk(part.found, known)
            tasks.append(Task(f"chunk_{part.begin}", part.begin, part.end, found))
            todo.append(part)
        elif head.error:
            part.own = Outcome(None, head.error)
        elif begin < part.end:
            tasks.append(Task(f"chunk_{part.begin}", begin, part.end, start if known is None else known))
            todo.append(part)
    _LOG.info("tracking the chunks")
    for part, outcome in zip(todo, _run_all(run, tasks), strict=True):
        part.own = outcome
    return parts


def _find_repeated(skeleton: Skeleton, parts: Sequence[_Part]) -> list[int]:
    """Join parts to the ones before them, and list those that are to be tracked again from there.

    A part is joined again if the one before has changed. It is not listed if that one is: it may not have to be tracked again.
    """
    todo = list[int]()
    for number, (before, part) in enumerate(pairwise(parts), 1):
        last = before.last
        if number - 1 in todo or last is None or part.joined_to is before.outcome:
            continue
        assert part.found is not None
        part.joined_to, part.again = before.outcome, None
        good = last.verdict == "good"
        part.distance = pose_distance(skeleton, last.pose, part.found.pose) if good else np.nan
        if not agrees(skeleton, last, part.found):
            todo.append(number)
    return todo


def _repeat(before: _Part, part: _Part) -> Task:
    """Make the task that tracks a part again, from the last frame of the part before."""
    part.num_again += 1
    return Task(f"{REPEATED}{part.begin}_{part.num_again}", part.begin, part.end, before.last)


def _run_all(run: RunTasks, tasks: Sequence[Task]) -> list[Outcome]:
    """Run tasks; return their outcomes in their order."""
    outcomes = dict(run(tasks)) if tasks else {}
    return [outcomes[number] for number in range(len(tasks))]


def _boundaries(chunks: Sequence[Chunk], parts: Sequence[_Part]) -> Iterator[Boundary]:
    """Describe the boundary before each chunk but the first one."""
    joined = {part.begin: before.last is not None for before, part in pairwise(parts)}
    part_of = {part.begin: part for part in parts[1:]}
    for chunk in chunks[1:]:
        part = part_of.get(chunk.begin)
        if part is None:
            yield Boundary(chunk.begin, np.nan, False, 0, True)
        else:
            repeated = part.again is not None
            count = part.end - part.begin if repeated else 0
            yield Boundary(chunk.begin, part.distance, not repeated, count, joined[chunk.begin])


def _failures(parts: Sequence[_Part]) -> Iterator[Failure]:
    """List the frames that could not be tracked."""
    for part in parts:
        if part.outcome.error:
            segments = part.segments
            yield Failure(segments[-1].end if segments else part.begin, part.end, part.outcome.error)
