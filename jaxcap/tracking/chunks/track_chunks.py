"""Tracking of one long sequence on several workers."""

import contextlib
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import TYPE_CHECKING, NamedTuple

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
from ...value_checks import check_direction
from ..advance import FirstSearch
from ..judge_frame import TrackedFrame
from ..track_frame import Tracker, check_sigma
from .division import count_chunks, divide_frames
from .join_chunks import Boundary, Failure, Outcome, RunTasks, join_chunks
from .segments import StackedFrames
from .tasks import Task, TrackSettings, track_task

if TYPE_CHECKING:
    from distributed import Client


class ChunkedFrames(NamedTuple):
    """A sequence that was tracked in chunks."""

    #: None for frames that could not be tracked
    frames: list[TrackedFrame | None]
    boundaries: tuple[Boundary, ...]
    failures: tuple[Failure, ...]


@checked
def track_chunks(
    tracker: Tracker,
    clouds: Sequence[Cloud | Scan] | Cloud,
    start: Pose | TrackedFrame | None = None,
    *,
    client: "Client | None" = None,
    chunks: int | None = None,
    search: FirstSearch = "auto",
    sigma: float = 0.1,
    up: tuple[float, float, float] = (0.0, 1.0, 0.0),
    first: int = 0,
    planes: Sequence[Plane] | None = None,
) -> ChunkedFrames:
    """Track one long sequence in chunks on the workers of a cluster.

    Some frames before each chunk its pose is found anew, as after a gap in the recording. The chunk continues from it if it
    agrees with the pose in the chunk before, and is otherwise tracked again from that one.
    What one run finds in its first frames, floors and walls and the baseline of verdicts, is found once, for all chunks.
    So the poses depend on the division, and not on the number of workers.

    **Arguments:** `client` is one of `dask.distributed`; by default a cluster of this computer is started. `chunks` is the number of
    chunks, by default `count_chunks`. `start`, `search`, `sigma`, `up`, `first` and
    `planes` as in `track_frames`. A sequence that loads its clouds on access, as
    `read_clouds` returns, loads them on the workers, which then need the files at the same paths.

    A chunk with a cloud that cannot be tracked does not stop the others: its frames are None from there on, and it is in
    `failures`. If the cloud is among the `WARM_UP` frames before a chunk, all frames of this chunk are None, too. The frames of a
    chunk after it are not `joined`. All frames are kept in memory.

    Workers of a `client` should have one thread of XLA each (`open_cluster`): with other numbers of threads sums have other rounding errors.

    **Raises:** `InputError` for arguments out of range, and as `map_jobs` does.
    """
    check_sigma("track_chunks", sigma)
    check_direction("track_chunks", up=up)
    sequence = CloudFrames(clouds)
    if not len(sequence):
        return ChunkedFrames([], (), ())
    number = count_chunks(len(sequence)) if chunks is None else chunks
    divided = divide_frames(len(sequence), number, first)
    room = first_room(sequence) if planes is None else planes
    settings = TrackSettings(search, sigma, up, tuple(room))
    with contextlib.nullcontext(client) if client is not None else open_cluster(threads=1) as opened:
        run = run_on(opened, partial(_track, tracker, settings), partial(_with_clouds, clouds, first))
        joined = join_chunks(tracker, divided, run, start)
    frames: list[TrackedFrame | None] = [None] * len(sequence)
    for span in joined.spans:
        frames[span.first - first : span.end - first] = span.frames()
    return ChunkedFrames(frames, joined.boundaries, joined.failures)


def first_room(clouds: Sequence[Cloud]) -> tuple[Plane, ...]:
    """Find the floors and walls of the first cloud with points."""
    for cloud in clouds:
        if not cloud.missing:
            return find_room(cloud)
    return ()


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
