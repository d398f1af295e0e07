"""The tasks of which a sequence in chunks is made: successive frames that one worker tracks."""

import dataclasses
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Literal, NamedTuple

import equinox as eqx
import jax.numpy as jnp

from ...arguments import checked
from ...body.pose import Pose
from ...energy.priors.reference_pose import tangent_deviations
from ...observe import Scan
from ...observe.clouds import Cloud
from ...observe.planes import Plane
from ..advance import FirstSearch, Search
from ..judge_frame import NO_SEARCHES, TrackedFrame
from ..judgement.baseline import NUM_FIRST_FRAMES
from ..missing import has_begun
from ..track import track_frames
from ..track_frame import Tracker
from .agreement import TOLERANCE, AgreementTest
from .segments import AbstractSegment

#: of a tracker that soon forgets where it began: least iterations, largest share of the last change in a prediction, and least
#: standard deviations from it, metres and radians
ITERATIONS, MOMENTUM, MOTION_DEVIATION = 6, 0.7, (0.1, 1.0)
#: step of the grid of its states, metres and radians: hundredths of a millimetre at the end of a limb
ROUNDING = 2.0**-15
#: when a task ends before its last frame: never; with the first frame that shows a person; when the sequence has a baseline; or
#: when it agrees with frames that were tracked before
Stop = Literal["never", "found", "learned", "agreed"]


class TrackSettings(NamedTuple):
    """The settings of `track_frames` that are the same for all tasks of a sequence."""

    search: FirstSearch = "auto"
    sigma: float = 0.1
    up: tuple[float, float, float] = (0.0, 1.0, 0.0)
    planes: Sequence[Plane] = ()
    #: as of `compare_frames`
    tolerance: float = TOLERANCE


class Task(NamedTuple):
    """Successive frames that one worker tracks."""

    #: names the result, and is unique in a sequence
    name: str
    #: numbers of the first frame and of the one after the last frame
    first: int
    end: int
    #: the frame before the first one; or a pose near the first frame, or None for the rest pose
    start: TrackedFrame | Pose | None
    stop: Stop = "never"
    #: the frames of an earlier task, with which this one is to agree
    expected: AbstractSegment | None = None


def track_task(
    tracker: Tracker,
    clouds: Iterable[Cloud | Scan] | Cloud,
    task: Task,
    settings: TrackSettings,
    on_search: Callable[[Search], None] | None = None,
    done: Iterable[TrackedFrame] = (),
) -> Iterator[TrackedFrame]:
    """Track the frames of a task; yield each as soon as it is done.

    **Arguments:** `clouds` of all frames that are still to be tracked; `done`, the frames of an interrupted run of the same task,
    which are not yielded again.

    **Raises:** `InputError` as `track_frames` does.
    """
    ends = _end_test(tracker, task, settings)
    start, first = task.start, task.first
    for frame in done:
        start, first = frame, first + 1
        if ends(frame):
            return
    frames = track_frames(
        tracker,
        clouds,
        start,
        # the first frame of a later chunk has no pose to begin at
        search="auto" if task.stop == "found" and settings.search is False else settings.search,
        sigma=settings.sigma,
        up=settings.up,
        first=first,
        on_search=on_search,
        planes=settings.planes,
    )
    for frame in frames:
        yield frame
        if ends(frame):
            return


def _end_test(tracker: Tracker, task: Task, settings: TrackSettings) -> Callable[[TrackedFrame], bool]:
    """Make the function that decides if a frame is the last one of a task."""
    if task.stop == "found":
        return has_begun
    if task.stop == "learned":
        return has_baseline
    if task.expected is not None:
        return AgreementTest(tracker.body.skeleton, task.expected, task.first, settings.tolerance)
    return lambda frame: False


def has_baseline(frame: TrackedFrame) -> bool:
    """Test if enough good frames are known for the level with which all later frames are compared."""
    return float(frame.baseline.frames) >= NUM_FIRST_FRAMES


@checked
def forgetful_tracker(tracker: Tracker) -> Tracker:
    """Return a tracker whose frames depend so little on the frames before them that runs from different poses become equal.

    With the default settings they do not: velocities of joints with few points, such as those of fingers, are predicted
    undamped, and four iterations do not reach the best pose of a frame. Differences of 1e-7 then grow to millimetres. This tracker has at least
    `ITERATIONS` iterations, predicts at most `MOMENTUM` of the last change, has wider deviations from the prediction, and rounds the state between
    frames to multiples of `ROUNDING`. Frames take up to twice as long. In one take of two, errors were the same and runs became equal; in a fast
    one, those of fingers were larger and runs did not become equal.
    """
    deviations = tangent_deviations(tracker.body.skeleton, *MOTION_DEVIATION)
    made = eqx.tree_at(
        lambda t: (t.momentum, t.motion_deviations),
        tracker,
        (
            jnp.minimum(tracker.momentum, MOMENTUM),
            jnp.maximum(tracker.motion_deviations, deviations.astype(tracker.motion_deviations.dtype)),
        ),
    )
    return dataclasses.replace(made, iterations=max(tracker.iterations, ITERATIONS), rounding=ROUNDING)


def begin_chunk(found: TrackedFrame, head: TrackedFrame) -> TrackedFrame:
    """Continue from the pose of a frame that was found by a search, with all else that the beginning of the sequence has shown.

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
