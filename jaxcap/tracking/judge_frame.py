"""A tracked frame, its judgement, and whether it is to be searched for."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..body.pose import Pose
from ..observe.clouds import Cloud
from ..stacking import device_array
from .expectation_maximisation.clothes import clothes_allowance
from .expectation_maximisation.em_step import Estimate, FrameStatistics
from .expectation_maximisation.pose_log_density import pose_log_density
from .judgement.baseline import (
    Baseline,
    initial_baseline,
    mark_flagged,
    sensor_directions,
    update_baseline,
)
from .judgement.evidence import gather_evidence
from .judgement.region_samples import RegionSamples
from .judgement.verdict import Judgement, judge_evidence
from .track_frame import Tracker, TrackState, start_state, track_frame, with_clothes

#: standard deviation at the end of a first frame, metres, and number of rounds to reach it
FIRST_SIGMA, FIRST_ROUNDS = 0.02, 6
#: pause in frames after a search without success, which doubles from the first number to the second
MIN_PAUSE, MAX_PAUSE = 2.0, 128.0
#: share of outliers above which the body is not in the cloud, and the next frame starts at the last good pose
MAX_OUTLIER_SHARE = 0.5
#: the largest share of the tolerance that faults in clothes have in a first frame: it is doubtful, not lost
DOUBTFUL_BY_CLOTHES = 0.99
#: gain of the log-density of a pose, for each point, that counts more than faults
MUCH_LIKELIER = 0.1

track_frame_jit = eqx.filter_jit(track_frame)


class SearchHistory(eqx.Module):
    """The number of searches, and the pause after searches without success."""

    #: frames until the next search is allowed, and the next fit from hypotheses
    wait: float = 0.0
    #: length of the pause after the last search
    length: float = 0.0
    #: number of searches so far
    count: float = 0.0

    def advance(self, good: bool) -> "SearchHistory":
        """Advance by one frame; good frames shorten the pauses again."""
        return SearchHistory(
            max(self.wait - 1.0, 0.0), 0.5 * self.length if good else self.length, self.count
        )

    def extend(self) -> "SearchHistory":
        """Count a search without success, and double the pause after it."""
        pause = min(max(2.0 * self.length, MIN_PAUSE), MAX_PAUSE)
        return SearchHistory(pause, pause, self.count + 1.0)


NO_SEARCHES = SearchHistory()


class TrackedFrame(eqx.Module):
    """One frame of a tracked sequence."""

    pose: Pose
    statistics: FrameStatistics
    #: the body does not explain the frame, and its pose is unreliable
    lost: bool
    #: faults by part, compared with the previous frames
    judgement: Judgement
    #: the cloud has another object of a person's size, whose points are outliers
    others: bool
    #: start of the next frame; with the three fields below it is sufficient to resume after a stop
    state: TrackState
    #: pose of the last frame that was not lost, including this one
    trusted: Pose
    #: statistics of the good frames so far
    baseline: Baseline
    #: searches so far, including this frame's
    searches: SearchHistory

    @property
    def verdict(self) -> str:
        """`good`, `doubtful` or `lost`."""
        return verdict_of(self.lost, self.judgement)

    @property
    def reasons(self) -> tuple[str, ...]:
        """The faults and their parts, such as "unexplained points near the left leg"; empty if the frame is
        good.
        """
        return reasons_of(self.lost, self.judgement)

    @property
    def unseen(self) -> tuple[str, ...]:
        """Parts without points, by their joints: their pose is a guess, also in a good frame. Empty for a
        lost frame.
        """
        return unseen_of(self.lost, self.judgement)


def verdict_of(lost: bool, judgement: Judgement) -> str:
    """Return `good`, `doubtful` or `lost`."""
    return "lost" if lost else judgement.verdict


def reasons_of(lost: bool, judgement: Judgement) -> tuple[str, ...]:
    """List the faults of a frame and their parts; a lost frame always has a reason."""
    if lost and not judgement.reasons:
        return ("no finite pose",)
    return judgement.reasons


def unseen_of(lost: bool, judgement: Judgement) -> tuple[str, ...]:
    """List the unobserved parts of the body; none for a lost frame."""
    return () if lost else judgement.unseen


def track_first_frame(
    tracker: Tracker,
    surface: RegionSamples,
    cloud: Cloud,
    pose: Pose,
    sigma: float,
    occluders: Float[Array, "O 4"] | None = None,
) -> TrackedFrame:
    """Track the first frame from a pose near it.

    The standard deviation falls from `sigma`, over repeated tracking of the same cloud, which uses the
    function that is compiled anyway. There is no baseline yet, and limits are absolute.
    """
    last = min(sigma, FIRST_SIGMA)
    state = start_state(tracker, pose, sigma)
    for level in np.geomspace(sigma, last, FIRST_ROUNDS)[:-1]:
        state, _ = track_frame_jit(tracker, reset_velocity(tracker, state, float(level)), cloud)
    state, statistics = track_frame_jit(tracker, reset_velocity(tracker, state, last), cloud)
    baseline = initial_baseline(surface, len(cloud.views))
    reached = reset_velocity(tracker, state)
    frame = judge_frame(surface, cloud, reached, statistics, baseline, occluders=occluders)
    return finish_frame(tracker, frame, pose)


def judge_frame(
    surface: RegionSamples,
    cloud: Cloud,
    state: TrackState,
    statistics: FrameStatistics,
    baseline: Baseline,
    searches: SearchHistory = NO_SEARCHES,
    occluders: Float[Array, "O 4"] | None = None,
) -> TrackedFrame:
    """Compare a frame with the `baseline`, and update this if the frame is good; `occluders` as in `gather_evidence`.

    Doubtful frames would gradually make their faults normal. The first frame that is not lost has nothing to
    be compared with, and updates them. Points in the clothes that a sequence has shown are explained. In a first frame,
    what looks like clothes may be a wrong pose: it is doubtful.
    """
    pose, clothes = state.estimate.pose, state.estimate.clothes
    allowance = None if clothes is None else clothes_allowance(clothes)
    judgement, renewed = _compare(surface, baseline, pose, cloud, occluders, allowance)
    if clothes is not None and float(baseline.frames) == 0:
        bare, _ = _compare(surface, baseline, pose, cloud, occluders, None)
        doubtful = jnp.minimum(bare.shares, DOUBTFUL_BY_CLOTHES * judgement.tolerance)
        judgement = eqx.tree_at(lambda j: j.shares, judgement, jnp.maximum(judgement.shares, doubtful))
    # copied once, as verdicts read it often
    judgement = jax.device_get(judgement)
    lost = judgement.verdict == "lost" or not is_finite(pose)
    teaches = not lost and (judgement.verdict == "good" or float(baseline.frames) == 0)
    renewed = renewed if teaches else mark_flagged(baseline)
    return TrackedFrame(pose, statistics, lost, judgement, False, state, pose, renewed, searches)


@eqx.filter_jit
def _compare(
    surface: RegionSamples,
    baseline: Baseline,
    pose: Pose,
    cloud: Cloud,
    occluders: Float[Array, "O 4"] | None,
    allowance: Float[Array, "J"] | None,
) -> tuple[Judgement, Baseline]:
    cameras = [view.camera for view in cloud.views]
    sensors = cameras or sensor_directions(baseline)
    evidence = gather_evidence(surface, pose, cloud, sensors, occluders, allowance)
    return judge_evidence(surface, baseline, evidence), update_baseline(baseline, evidence)


def finish_frame(tracker: Tracker, frame: TrackedFrame, previous: Pose) -> TrackedFrame:
    """Determine the start of the next frame: the last trusted pose, `previous`, if the body is not in the
    cloud.
    """
    searches = frame.searches.advance(frame.verdict == "good")
    pose, state = frame.pose, frame.state
    if frame.lost:
        finite = is_finite(pose)
        if not finite or not float(frame.statistics.outlier_share) < MAX_OUTLIER_SHARE:
            state = start_state(with_clothes(tracker, state.estimate.clothes), previous, FIRST_SIGMA)
        pose = pose if finite else previous
    trusted = previous if frame.lost else pose
    return dataclasses.replace(frame, pose=pose, trusted=trusted, state=state, searches=searches)


def needs_search(frame: TrackedFrame) -> bool:
    """Decide if a frame is to be searched for: it is not good, and no search has just failed."""
    return frame.verdict != "good" and frame.searches.wait <= 0


def choose_better(tracker: Tracker, cloud: Cloud, found: TrackedFrame, frame: TrackedFrame) -> TrackedFrame:
    """Choose between two poses of one frame: `found` if it is likelier and its worst fault is smaller, or if it is much likelier.

    Two poses may have the same worst fault, such as hair that the body does not have.
    """
    before, after = (float(pose_log_density(tracker, one.pose, cloud)) for one in (frame, found))
    is_better = after >= before and found.judgement.worst < frame.judgement.worst
    return found if is_better or after >= before + MUCH_LIKELIER else frame


def is_finite(pose: Pose) -> bool:
    """Decide if all numbers of a pose are finite."""
    return all(bool(np.isfinite(leaf).all()) for leaf in jax.tree.leaves(pose))


def reset_velocity(tracker: Tracker, state: TrackState, sigma: float | None = None) -> TrackState:
    """Reset the velocity of a state and optionally set the initial standard deviation of the next frame."""
    estimate = state.estimate
    if sigma is not None:
        level = jnp.asarray(sigma, estimate.sigma.dtype) / tracker.sigma_growth
        estimate = Estimate(estimate.pose, level, estimate.priors, estimate.clothes)
    return TrackState(estimate, device_array(np.zeros(state.change.shape), state.change.dtype))
