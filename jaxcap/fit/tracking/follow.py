"""The step from one tracked frame to the next, without a search."""

from collections.abc import Sequence

from ...body.pose import Pose
from ...observe.clouds import Cloud
from ..judgement.region_samples import RegionSamples
from .compare_poses import choose_likeliest
from .recover import TrackedFrame, judge_frame, reset_velocity, track_frame_jit
from .track_frame import Tracker


def follow_frame(
    tracker: Tracker,
    surface: RegionSamples,
    frame: TrackedFrame,
    cloud: Cloud,
    poses: Sequence[Pose] = (),
    margin: float = 0.0,
    judge: bool = True,
) -> TrackedFrame:
    """Track and judge the frame after `frame`; `finish_frame` then determines the start of the one after it.

    **Arguments:** `poses`, other candidate poses, and `margin` as in `choose_likeliest`. Without `judge` the frame keeps the
    verdict of the frame before it.
    """
    before = frame.state.estimate.pose
    state, statistics = track_frame_jit(tracker, frame.state, cloud)
    # a lost frame may have led away from the correct pose
    others = [*([frame.trusted] if frame.lost else []), *poses]
    if others:
        state, statistics = choose_likeliest(tracker, state, statistics, others, before, cloud, margin)
    if frame.lost:
        state = reset_velocity(tracker, state)
    if not judge:
        return TrackedFrame(
            state.estimate.pose,
            statistics,
            frame.lost,
            frame.judgement,
            state,
            state.estimate.pose,
            frame.baseline,
            frame.searches,
        )
    return judge_frame(surface, cloud, state, statistics, frame.baseline, frame.searches)
