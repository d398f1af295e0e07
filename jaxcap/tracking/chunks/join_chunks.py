"""Chunks that are tracked at the same time, joined where they agree, and tracked again from the chunk before where they do not.

Tracking is sequential: a frame begins in the state of the frame before. But a state is soon forgotten: runs that begin at different poses
become the same within some frames, if the clouds determine the pose. So each chunk begins some frames early, at a pose that a search
finds. Where it has become the same as the chunk before, the rest is what one run would have computed. Where it has not,
the chunk before is continued until it agrees. So every boundary is checked from the first one on, and the result is that of one run.
"""

import logging
from collections.abc import Callable, Iterable, Sequence
from typing import NamedTuple

import numpy as np

from ...body.pose import Pose
from ...body.skeleton import Skeleton
from ..judge_frame import TrackedFrame
from .agreement import MAX_SHARE_DIFFERENCE, TOLERANCE, compare_frames
from .division import AGREEING_FRAMES, Chunk
from .segments import AbstractSegment, JoinedSegment, last_frame
from .tasks import Task, begin_chunk

_LOG = logging.getLogger(__name__)

#: beginning of the names of tasks that track frames again
REPEATED = "again_"


class Outcome(NamedTuple):
    """The frames of a task, up to the first one that could not be tracked, and the sentence of the error; it has none if all are there."""

    segment: AbstractSegment | None
    error: str = ""


#: runs tasks at the same time; yields the number and the outcome of each as it ends
RunTasks = Callable[[Sequence[Task]], Iterable[tuple[int, Outcome]]]


class Boundary(NamedTuple):
    """The boundary between a chunk and the one before it."""

    #: number of the first frame after it
    frame: int
    #: largest distance of a joint between the two chunks in the last frames before it, metres; NaN without common frames
    distance: float
    #: largest difference there between the shares of limits in verdicts
    share_difference: float
    #: number of frames after it that were tracked again from the chunk before
    num_repeated: int
    #: the chunk continues the one before; if not, its frames are those of a run that began at its own search
    joined: bool

    @property
    def margin(self) -> float:
        """The difference in the shares of limits that one run may have after the boundary."""
        return MAX_SHARE_DIFFERENCE if self.num_repeated else self.share_difference


class Failure(NamedTuple):
    """Frames that could not be tracked."""

    first: int
    end: int
    #: a sentence
    message: str


class JoinedChunks(NamedTuple):
    """The frames of a sequence, and how its chunks were joined."""

    #: those of each chunk, in order; shorter than the chunk, or None, if it failed
    chunks: tuple[JoinedSegment | None, ...]
    boundaries: tuple[Boundary, ...]
    failures: tuple[Failure, ...]


class _State:
    """The frames of each chunk so far, and which boundaries are joined."""

    def __init__(self, chunks: Sequence[Chunk]):
        self.chunks = chunks
        self.frames: list[JoinedSegment | None] = [None] * len(chunks)
        self.errors: list[str] = [""] * len(chunks)
        #: how often the last frame of each chunk has changed, and the number at which the chunk after it was joined
        self.versions, self.joined = [0] * len(chunks), [-1] * len(chunks)
        #: distances and differences of shares at the first comparison
        self.differences = [(np.nan, np.nan)] * len(chunks)
        self.repeated = [0] * len(chunks)

    def is_complete(self, number: int) -> bool:
        frames = self.frames[number]
        return frames is not None and frames.end == self.chunks[number].end

    def is_joined(self, number: int) -> bool:
        return number == 0 or (
            self.is_complete(number - 1) and self.joined[number] == self.versions[number - 1]
        )

    def pending(self) -> list[int]:
        """List the chunks that are to be compared with the one before."""
        numbers = range(1, len(self.chunks))
        return [
            k for k in numbers if self.is_complete(k - 1) and not self.errors[k] and not self.is_joined(k)
        ]


def join_chunks(
    skeleton: Skeleton,
    chunks: Sequence[Chunk],
    run: RunTasks,
    start: Pose | TrackedFrame | None = None,
    tolerance: float = TOLERANCE,
) -> JoinedChunks:
    """Track all chunks by `run`, and join them where they agree (`compare_frames`).

    **Arguments:** `start` as of `track_frames`, for the first chunk.

    The first frames of the sequence are tracked while the first poses of the other chunks are searched for: all chunks have the
    baseline of the beginning. Then the chunks are tracked. In a third step chunks that do not agree with the one before are
    tracked again, from their first frame up to `AGREEING_FRAMES` frames that agree with the earlier result. A chunk that never agrees
    is tracked again as a whole. The chunk after it is then compared again, with the new frames.
    """
    state = _State(chunks)
    _track_all(state, run, start)
    is_first = True
    while pending := state.pending():
        todo = [number for number in pending if not _compare(skeleton, state, number, tolerance)]
        if not is_first:
            # the chunk after one that is tracked again may have to be tracked again because of that
            todo = [number for number in todo if number - 1 not in todo]
        _repeat(state, run, todo)
        is_first = False
    boundaries = [
        Boundary(chunk.begin, *state.differences[k], state.repeated[k], state.is_joined(k))
        for k, chunk in enumerate(chunks)
    ]
    return JoinedChunks(tuple(state.frames), tuple(boundaries[1:]), tuple(_failures(state)))


def _track_all(state: _State, run: RunTasks, start: Pose | TrackedFrame | None) -> None:
    """Track each chunk from its own search."""
    first, *others = state.chunks
    tasks = [Task("head", first.first, first.end, start, "learned")]
    tasks += [Task(f"start_{k}", c.first, c.end, None, "found") for k, c in enumerate(others, 1)]
    _LOG.info("tracking the first frames, and searching for the first pose of each chunk")
    outcomes = _run_all(run, tasks)
    head = outcomes[0].segment
    known = None if head is None or head.first == head.end else last_frame(head)
    tasks, numbers = [], []
    for number, (chunk, outcome) in enumerate(zip(state.chunks, outcomes, strict=True)):
        found, state.errors[number] = outcome
        if found is None or found.first == found.end:
            continue
        if number == 0:
            state.frames[0] = JoinedSegment([]).replace_first(found)
        if found.end < chunk.end and not outcome.error:
            last = last_frame(found)
            begin = last if number == 0 or known is None else begin_chunk(last, known)
            tasks.append(Task(f"chunk_{number}", found.end, chunk.end, begin))
            numbers.append(number)
    _LOG.info("tracking the chunks")
    for number, (segment, error) in zip(numbers, _run_all(run, tasks), strict=True):
        state.errors[number] = error
        before = state.frames[number]
        if segment is not None and segment.first < segment.end:
            spans = [] if before is None else before.spans
            joined = JoinedSegment([*spans, *JoinedSegment([]).replace_first(segment).spans])
            state.frames[number] = joined


def _compare(skeleton: Skeleton, state: _State, number: int, tolerance: float) -> bool:
    """Compare a chunk with the one before, in the last frames before the boundary; join it if they agree."""
    begin, own, before = state.chunks[number].begin, state.frames[number], state.frames[number - 1]
    first = begin - AGREEING_FRAMES
    if own is None or before is None or own.first > first or before.first > first:
        return False
    pairs = zip(before.frames(first, begin), own.frames(first, begin), strict=True)
    found = [compare_frames(skeleton, one, other, tolerance) for one, other in pairs]
    if np.isnan(state.differences[number][0]):
        state.differences[number] = (
            max(comparison.distance for comparison in found),
            max(comparison.share_difference for comparison in found),
        )
    agree = all(comparison.agree for comparison in found)
    if agree:
        state.joined[number] = state.versions[number - 1]
    return agree


def _repeat(state: _State, run: RunTasks, numbers: Sequence[int]) -> None:
    """Track chunks again, each from the last frame of the one before until it agrees with its earlier frames."""
    if not numbers:
        return
    _LOG.info("tracking %d chunks again that do not agree with the one before", len(numbers))
    tasks = []
    for number in numbers:
        chunk, before = state.chunks[number], state.frames[number - 1]
        assert before is not None
        # the same chunk may be tracked again for each change of the one before
        name = f"{REPEATED}{number}_{state.versions[number - 1]}"
        tasks.append(Task(name, chunk.begin, chunk.end, last_frame(before), "agreed", state.frames[number]))
    versions = [state.versions[number - 1] for number in numbers]
    for number, version, (segment, error) in zip(numbers, versions, _run_all(run, tasks), strict=True):
        state.errors[number] = error
        if segment is None or segment.first == segment.end:
            continue
        own = state.frames[number]
        state.frames[number] = (own or JoinedSegment([])).replace_first(segment)
        state.repeated[number] = max(state.repeated[number], segment.end - segment.first)
        if not error:
            state.joined[number] = version
            state.versions[number] += segment.end == state.chunks[number].end


def _run_all(run: RunTasks, tasks: Sequence[Task]) -> list[Outcome]:
    """Run tasks; return their outcomes in their order."""
    outcomes = dict(run(tasks)) if tasks else {}
    return [outcomes[number] for number in range(len(tasks))]


def _failures(state: _State) -> list[Failure]:
    """List the frames of chunks that could not be tracked, or could not be tracked again from the chunk before."""
    failures = []
    for number, (chunk, error) in enumerate(zip(state.chunks, state.errors, strict=True)):
        if error:
            frames = state.frames[number]
            last = chunk.begin if frames is None else max(frames.end, chunk.begin)
            failures.append(Failure(last if last < chunk.end else chunk.begin, chunk.end, error))
    return failures
