"""Frames that show no person: lost, with the pose of the frame before."""

import jax.numpy as jnp

from ..body.pose import Pose
from ..observe.clouds import Cloud
from .expectation_maximisation.em_step import FrameStatistics
from .judge_frame import FIRST_SIGMA, NO_SEARCHES, TrackedFrame
from .judgement.baseline import initial_baseline
from .judgement.region_samples import RegionSamples
from .judgement.verdict import nothing_to_judge
from .track_frame import Tracker, start_state


def missing_frame(
    tracker: Tracker, surface: RegionSamples, cloud: Cloud, before: TrackedFrame | None, start: Pose
) -> TrackedFrame:
    """Make the frame of a cloud that is `missing`: lost, with the last trusted pose, from which the next one starts.

    **Arguments:** `before`, the previous frame; without one the pose is `start`.
    """
    pose = start if before is None else before.trusted
    baseline = initial_baseline(surface, len(cloud.views)) if before is None else before.baseline
    searches = NO_SEARCHES if before is None else before.searches.advance(False)
    state = start_state(tracker, pose, FIRST_SIGMA)
    unknown = jnp.full((), jnp.nan, pose.rotations.dtype)
    statistics = FrameStatistics(unknown, unknown, unknown, unknown, state.estimate.sigma)
    judgement = nothing_to_judge(surface, baseline)
    return TrackedFrame(pose, statistics, True, judgement, False, state, pose, baseline, searches)


def has_begun(frame: TrackedFrame) -> bool:
    """Test if any frame so far showed a person: every such frame updates or marks the baseline."""
    return float(frame.baseline.frames) > 0 or float(frame.baseline.flagged) > 0
