"""Comparison of poses of one frame by one likelihood, to keep the best."""

from collections.abc import Iterable

import equinox as eqx

from ..body.pose import Pose
from ..body.retraction import difference
from ..observe.clouds import Cloud
from .expectation_maximisation.em_step import FrameStatistics
from .expectation_maximisation.pose_log_density import pose_log_density
from .judge_frame import reset_velocity, track_frame_jit
from .track_frame import Tracker, TrackState, start_state

#: a pose with a `pose_log_density` below the best by more than this is not improved
MAX_DEFICIT = 0.3

_change = eqx.filter_jit(difference)


def track_from(
    tracker: Tracker, pose: Pose, cloud: Cloud, likelihood: float | None = None
) -> tuple[TrackState, FrameStatistics, float]:
    """Track a frame from a nearby pose, by the tracker's own steps; never to a less likely pose.

    Returns the result of `track_frame`, and the `pose_log_density` of the pose; `likelihood` is that of the pose given, if
    it is known.
    """
    state, statistics = track_frame_jit(
        tracker, reset_velocity(tracker, start_state(tracker, pose), 0.0), cloud
    )
    state = reset_velocity(tracker, state)
    before = float(pose_log_density(tracker, pose, cloud)) if likelihood is None else likelihood
    after = float(pose_log_density(tracker, state.estimate.pose, cloud))
    if after >= before:
        return state, statistics, after
    return eqx.tree_at(lambda s: s.estimate.pose, state, pose), statistics, before


def choose_likeliest(
    tracker: Tracker,
    state: TrackState,
    statistics: FrameStatistics,
    poses: Iterable[Pose],
    previous: Pose,
    cloud: Cloud,
    margin: float = 0.0,
) -> tuple[TrackState, FrameStatistics]:
    """Choose between the tracked pose of a frame and some other `poses`, unchanged and improved.

    **Arguments:** `previous` is the pose of the previous frame, from which the body has moved; `margin` the
    `pose_log_density` by which another pose has to be better.

    The state and the statistics are the same objects if no other pose is better.
    """
    best = float(pose_log_density(tracker, state.estimate.pose, cloud)) + margin
    for pose in poses:
        before = float(pose_log_density(tracker, pose, cloud))
        if before < best - MAX_DEFICIT:
            continue
        found, measured, likelihood = track_from(tracker, pose, cloud, before)
        if likelihood > best:
            change = _change(tracker.body.skeleton, previous, found.estimate.pose)
            best, state, statistics = likelihood, TrackState(found.estimate, change), measured
    return state, statistics


def likelier_pose(tracker: Tracker, first: Pose, second: Pose, cloud: Cloud) -> Pose:
    """Choose the likelier of two poses of a frame; the first where they are equal."""
    likelihoods = [float(pose_log_density(tracker, pose, cloud)) for pose in (first, second)]
    return first if likelihoods[0] >= likelihoods[1] else second
