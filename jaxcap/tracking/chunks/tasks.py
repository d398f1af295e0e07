"""The tasks of which a sequence in chunks is made: successive frames that one worker tracks."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import NamedTuple

import equinox as eqx

from ...body.pose import Pose
from ...observe import Scan
from ...observe.clouds import Cloud
from ...observe.planes import Plane
from ..advance import FirstSearch, Search
from ..judge_frame import NO_SEARCHES, TrackedFrame
from ..judgement.baseline import NUM_FIRST_FRAMES
from ..missing import has_begun
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
    #: ends with the frame that completes the baseline of the sequence
    is_head: bool = False
    #: its first frame is searched for, also where the settings forbid it
    is_search: bool = False


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
        search="auto" if task.is_search and settings.search is False else settings.search,
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


def begin_chunk(found: TrackedFrame, head: TrackedFrame) -> TrackedFrame:
    """Continue from a frame that was found by a search, with all else that the beginning of the sequence has shown.

    These are the baseline of verdicts, the shares of the parts, and the clothes.
    """
    if not has_begun(head):
        return found
    estimate = head.state.estimate
    return eqx.tree_at(
        lambda frame: (
            frame.state.estimate.priors,
            frame.state.estimate.clothes,
            frame.baseline,
            frame.searches,
        ),
        found,
        (estimate.priors, estimate.clothes, head.baseline, NO_SEARCHES),
        is_leaf=lambda leaf: leaf is None,
    )
