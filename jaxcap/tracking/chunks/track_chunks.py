"""Tracking of one long sequence on several workers."""

import contextlib
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

import jax

from ...arguments import checked
from ...batch.cluster import open_cluster
from ...batch.mapping import JobResult, map_jobs
from ...body.pose import Pose
from ...errors import InputError, user_message
from ...observe import Scan
from ...observe.clouds import Cloud, CloudFrames
from ...observe.floors_and_walls import find_room
from ...observe.planes import Plane
from ...value_checks import check_direction, check_positive
from ..advance import FirstSearch
from ..judge_frame import TrackedFrame
from ..track_frame import Tracker, check_sigma
from .agreement import TOLERANCE, is_unsure
from .division import OVERLAP, Chunk, check_overlap, count_chunks, divide_frames
from .join_chunks import Boundary, Failure, JoinedChunks, Outcome, RunTasks, join_chunks
from .segments import StackedFrames
from .tasks import Task, TrackSettings, forgetful_tracker, track_task

if TYPE_CHECKING:
    from distributed import Client


class ChunkedFrames(NamedTuple):
    """A sequence that was tracked in chunks."""

    #: None for frames that could not be tracked
    frames: list[TrackedFrame | None]
    boundaries: tuple[Boundary, ...]
    failures: tuple[Failure, ...]
    #: numbers of the frames whose verdict is so near a limit that it could be another one in one run, and with it the poses of
    #: some frames from there on
    unsure: tuple[int, ...]


@checked
def track_chunks(
    tracker: Tracker,
    clouds: Sequence[Cloud | Scan] | Cloud,
    start: Pose | TrackedFrame | None = None,
    *,
    client: "Client | None" = None,
    chunks: int | None = None,
    overlap: int = OVERLAP,
    tolerance: float = TOLERANCE,
    search: FirstSearch = "auto",
    sigma: float = 0.1,
    up: tuple[float, float, float] = (0.0, 1.0, 0.0),
    first: int = 0,
    planes: Sequence[Plane] | None = None,
) -> ChunkedFrames:
    """Track one long sequence in chunks on the workers of a cluster; the poses are those of one run.

    Each chunk begins `overlap` frames early, at a pose that a search finds. If it agrees with the chunk before in the last frames of
    the overlap, it is taken as it is. If not, it is tracked again from the last frame of the chunk before until it
    agrees; a chunk that never agrees is tracked again as a whole. Chunks agree if their joints are closer than `tolerance`, metres,
    in several frames that are good in both. What one run finds in its first frames, floors and walls and the baseline of verdicts, is
    found once, for all chunks.

    **Arguments:** `client` is one of `dask.distributed`; by default a cluster of this computer is started. `chunks` is the number of
    chunks, by default up to four for each worker, and fewer in a short sequence. `start`, `search`, `sigma`, `up`, `first` and
    `planes` as in `track_frames`; chunks after the first one always search. A sequence that loads its clouds on access, as
    `read_clouds` returns, loads them on the workers, which then need the files at the same paths.

    A chunk with a cloud that cannot be tracked does not stop the others: its frames are None from there on, and it is in
    `failures`. If the cloud is among the `overlap` frames before a chunk, all frames of this chunk are None, too. The frames of a
    chunk after it are not `joined`. All frames are held in memory.

    The tracker is made by `forgetful_tracker`, with more iterations than usual, and so should be that of a run to compare with: with the usual
    settings runs that begin at different poses never become equal. Workers of a `client` should have one thread of XLA each
    (`open_cluster`): with other numbers of threads sums have other rounding errors.

    **Raises:** `InputError` for arguments out of range, and as `map_jobs` does.
    """
    check_sigma("track_chunks", sigma)
    check_direction("track_chunks", up=up)
    check_positive("track_chunks", "metres", tolerance=tolerance)
    check_overlap(overlap)
    sequence = CloudFrames(clouds)
    if not len(sequence):
        return ChunkedFrames([], (), (), ())
    if chunks is not None:
        divide_frames(len(sequence), chunks, overlap)
    room = first_room(sequence) if planes is None else planes
    tracker = forgetful_tracker(tracker)
    settings = TrackSettings(search, sigma, up, tuple(room), tolerance)
    with contextlib.nullcontext(client) if client is not None else open_cluster(threads=1) as opened:
        number = count_chunks(len(sequence), count_workers(opened), overlap) if chunks is None else chunks
        divided = divide_frames(len(sequence), number, overlap, first)
        run = run_on(opened, partial(_track, tracker, settings), partial(_with_clouds, clouds, first))
        joined = join_chunks(tracker.body.skeleton, divided, run, start, tolerance)
    frames: list[TrackedFrame | None] = []
    for chunk, segment in zip(divided, joined.chunks, strict=True):
        end = chunk.begin if segment is None else min(segment.end, chunk.end)
        frames += segment.frames(chunk.begin, end) if segment is not None and end > chunk.begin else []
        frames += [None] * (chunk.end - max(end, chunk.begin))
    return ChunkedFrames(frames, joined.boundaries, joined.failures, tuple(_unsure_frames(divided, joined)))


def _unsure_frames(chunks: Sequence[Chunk], joined: JoinedChunks) -> Iterator[int]:
    """Iterate over the frames of joined chunks that may have another verdict in one run."""
    for chunk, segment, boundary in zip(chunks[1:], joined.chunks[1:], joined.boundaries, strict=True):
        if segment is not None and boundary.joined:
            first = boundary.frame + boundary.num_repeated
            for number, frame in enumerate(segment.frames(first, chunk.end), first):
                if is_unsure(frame.judgement, boundary.margin):
                    yield number


def first_room(clouds: Sequence[Cloud]) -> tuple[Plane, ...]:
    """Find the floors and walls of the first cloud with points."""
    for cloud in clouds:
        if not cloud.missing:
            return find_room(cloud)
    return ()


def count_workers(client: "Client") -> int:
    """Count the workers of a cluster."""
    threads: Any = client.nthreads()
    return max(len(threads), 1)


def run_on(client: "Client", function: Callable[..., Outcome], item_of: Callable[[Task], object]) -> RunTasks:
    """Make the function that runs tasks on a cluster: `function` of the items that are sent to the workers."""

    def run(tasks: Sequence[Task]) -> Iterator[tuple[int, Outcome]]:
        for result in map_jobs(function, [item_of(task) for task in tasks], client):
            yield result.number, outcome_of(result)

    return run


def outcome_of(result: JobResult) -> Outcome:
    """Return the outcome of a job; one whose worker died has no frames. Other errors than those of users are raised."""
    if result.error is None:
        return result.value
    if isinstance(result.error, InputError):
        return Outcome(None, user_message(result.error))
    raise result.error


def _with_clouds(
    clouds: Sequence[Cloud | Scan] | Cloud, first: int, task: Task
) -> tuple[Task, Sequence[Cloud | Scan] | Cloud]:
    """Return a task with its clouds, those in files unread."""
    numbers = slice(task.first - first, task.end - first)
    if isinstance(clouds, Cloud):
        return task, jax.tree.map(lambda leaf: leaf[numbers], clouds)
    return task, clouds[numbers]


def _track(
    tracker: Tracker, settings: TrackSettings, item: tuple[Task, Sequence[Cloud | Scan] | Cloud]
) -> Outcome:
    """Track the frames of a task on a worker, and return them."""
    task, clouds = item
    frames: list[TrackedFrame] = []
    error = ""
    try:
        for frame in track_task(tracker, clouds, task, settings):
            frames.append(frame)
    except InputError as reason:
        error = user_message(reason)
    return Outcome(StackedFrames(task.first, frames), error)
