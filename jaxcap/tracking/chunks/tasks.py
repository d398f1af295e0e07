"""The tasks of which a sequence in chunks is made: successive frames that one worker tracks."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

from ...body.pose import Pose
from ...observe import Scan
from ...observe.clouds import Cloud
from ...observe.planes import Plane
from ..advance import FirstSearch, Search
from ..judge_frame import NO_SEARCHES, TrackedFrame, reset_velocity
from ..judgement.baseline import NUM_FIRST_FRAMES
from ..track import track_frames
from ..track_frame import Tracker


class TrackSettings(NamedTuple):
    """The settings of `track_frames` that are the same for all tasks of a sequence."""

    search: FirstSearch = "auto"
    sigma: float = 0.1
    up: tuple[float, float, float] = (0.0, 1.0, 0.0)
    planes: Sequence[Plane] = ()


class Task(NamedTuple):
    """Successive frames that one worker tracks."""

    #: names the result, and is unique in a sequence
    name: str
    #: numbers of the first frame and of the one after the last frame
    first: int
    end: int
    #: the frame before the first one; or a pose near the first frame, or None for the rest pose
    start: TrackedFrame | Pose | None
    #: number of frames at its beginning that are not part of the result
    warm_up: int = 0
    #: ends with the frame that completes the baseline of the sequence
    is_head: bool = False


def track_task(
    tracker: Tracker,
    clouds: Iterable[Cloud | Scan] | Cloud,
    task: Task,
    settings: TrackSettings,
    on_search: Callable[[Search], None] | None = None,
) -> Iterator[TrackedFrame]:
    """Track the frames of a task; yield each as soon as it is done.

    An interrupted task is continued as a task from its last frame on.

    **Raises:** `InputError` as `track_frames` does.
    """
    if task.is_head and isinstance(task.start, TrackedFrame) and has_baseline(task.start):
        return
    frames = track_frames(
        tracker,
        clouds,
        task.start,
        search=settings.search,
        sigma=settings.sigma,
        up=settings.up,
        first=task.first,
        on_search=on_search,
        planes=settings.planes,
    )
    for frame in frames:
        yield frame
        if task.is_head and has_baseline(frame):
            return


def has_baseline(frame: TrackedFrame) -> bool:
    """Test if enough good frames are known for the level with which all later frames are compared."""
    return float(frame.baseline.frames) >= NUM_FIRST_FRAMES


def begin_chunk(tracker: Tracker, head: TrackedFrame) -> TrackedFrame:
    """Return the frame from which each chunk begins: the last one of the beginning of a sequence, at rest.

    It has what the beginning has shown: the baseline of verdicts, the shares of the parts, and the clothes. The pose in another frame is
    found from it as after a gap in a recording, by hypotheses of a fast motion and by a search.
    """
    return replace(head, state=reset_velocity(tracker, head.state), searches=NO_SEARCHES)
