"""Track whole sequences, as a stream or at once."""

import logging
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence

import jax
import numpy as np

from ..arguments import checked
from ..body.body import Body
from ..body.pose import Motion, Pose, rest_pose, stack_poses
from ..observe import Cloud, CloudFrames, Scan, as_cloud
from .check import check_cloud
from .initialise import coarse_tracker, initialise
from .likeliest import likelier_pose, likeliest
from .recover import TrackedFrame, doubtful, first_frame, judge, next_frame, recover
from .track import Tracker, make_tracker

_LOG = logging.getLogger(__name__)


@checked
def track_frames(
    tracker: Tracker,
    clouds: Iterable[Cloud | Scan] | Cloud,
    start: Pose | TrackedFrame | None = None,
    *,
    search: bool = False,
    sigma: float = 0.1,
    up: tuple[float, float, float] = (0.0, 1.0, 0.0),
    first: int = 0,
    known: Callable[[int], Sequence[Pose]] | None = None,
    worth: float = 0.0,
) -> Iterator[TrackedFrame]:
    """Track a stream of clouds; yields a frame as soon as it is done.

    **Arguments:** `start` is the pose to begin at, rest where not given, or the last
    `TrackedFrame` of a run that was stopped; with `search` the first pose is found by
    `initialise`; `sigma` metres is the deviation that the first frame starts with
    (Kineben's sigma0); `up` is the vertical of the scene; `first` is the number of the first
    cloud, so that a run that goes on searches as it would have; `known(number)` gives other poses that a frame
    may be in: the frame keeps the likeliest, and leaves the tracked pose only for one whose mean log-likelihood is
    better by more than `worth`.

    A frame that its forerunner does not lead to is searched for by many perturbed starts
    side by side; where none explains the cloud it is marked `lost`, and tracking goes on.
    """
    coarse = None
    frame, pose = (start, None) if isinstance(start, TrackedFrame) else (None, start)
    for number, cloud in enumerate(_each(clouds), first):
        if frame is None:
            pose = rest_pose(tracker.body.skeleton) if pose is None else pose
            if search:
                coarse = coarse_tracker(tracker)
                pose, _ = initialise(tracker, cloud, up=up, coarse=coarse)
                sigma = 0.03
            frame, before = first_frame(tracker, cloud, pose, sigma), pose
        else:
            before = frame.state.estimate.pose
            state, statistics = next_frame(tracker, frame.state, cloud)
            frame = judge(frame.usual, state, statistics)
        if known is not None:
            reached = frame.state, frame.statistics
            state, statistics = likeliest(tracker, *reached, known(number), before, cloud, worth)
            frame = frame if state is frame.state else judge(frame.usual, state, statistics)
        if doubtful(frame):
            _LOG.info("searching for a better pose of frame %d", number)
            coarse = coarse_tracker(tracker) if coarse is None else coarse
            found = recover(tracker, coarse, frame, before, cloud, jax.random.key(number), up)
            if known is not None and found.pose is not frame.pose:
                # what a search ends with may be worse than what it began with
                likelier = likelier_pose(tracker, found.pose, frame.pose, cloud)
                found = found if likelier is found.pose else frame
            frame = found
        yield frame


@checked
def track(
    body: Body,
    clouds: Iterable[Cloud | Scan] | Cloud,
    start: Pose | None = None,
    *,
    rate: float = 30.0,
    tracker: Tracker | None = None,
    search: bool = False,
    sigma: float = 0.1,
    up: tuple[float, float, float] = (0.0, 1.0, 0.0),
) -> Motion:
    """The motion of a body through a sequence of clouds (Kineben, section 3.3).

    **Arguments:** `clouds` from `make_cloud`, one a frame, or stacked over frames; `start` a pose near that of the first
    frame, or `search=True`; `rate` frames a second; `tracker` for other settings than the
    usual, made of the same body; `sigma` and `up` as in `track_frames`. Lost frames are named in a warning; `track_frames` tells more about each frame.

    **Raises:** `InputError` for a cloud with fewer points than the pose has parameters, or in
    another unit.
    """
    tracker = make_tracker(body) if tracker is None else tracker
    checked = (_checked(body, number, cloud) for number, cloud in enumerate(_each(clouds)))
    poses, lost = [], []
    for number, frame in enumerate(track_frames(tracker, checked, start, search=search, sigma=sigma, up=up)):
        # copies in NumPy: an array of JAX takes a kilobyte beside its numbers
        poses.append(jax.tree.map(np.array, frame.pose))
        if frame.lost:
            lost.append(number)
    if lost:
        warnings.warn(
            f"{len(lost)} of {len(poses)} frames are lost: {', '.join(map(str, lost[:20]))}.", stacklevel=2
        )
    return stack_poses(poses, rate)


def _each(clouds: Iterable[Cloud | Scan] | Cloud) -> Iterator[Cloud]:
    """The frames, also of scans as files have them, and of one cloud that is stacked over them."""
    if isinstance(clouds, (Cloud, Scan)):
        return iter(CloudFrames(clouds))  # pyright: ignore[reportArgumentType] - a scan is refused there
    return (as_cloud(cloud, number) for number, cloud in enumerate(clouds))


def _checked(body: Body, number: int, cloud: Cloud) -> Cloud:
    check_cloud(body, cloud, f"cloud {number}")
    return cloud
