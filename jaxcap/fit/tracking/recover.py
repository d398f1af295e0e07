"""Judge tracked frames, and search for those that their predecessor did not lead to."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import PRNGKeyArray

from ...body.pose import Pose
from ...energy.priors.prior import tangent_deviations
from ...observe import Cloud, thin_cloud
from ..judgement.evidence import gather_evidence
from ..judgement.surface import JudgedSurface
from ..judgement.usual import Usual, nothing_usual, renew, sensors_of, warned
from ..judgement.verdict import Judgement, judge_evidence
from .em import Estimate, FrameStatistics
from .initialise import (
    COARSE_POINTS,
    FINE,
    anneal_all,
    perturbed_starts,
    refine,
    subtree_starts,
    turned_starts,
)
from .track_frame import Tracker, TrackState, start_state, track_frame

#: deviation at the end of a first frame, metres, and rounds to get there
FIRST_SIGMA, FIRST_ROUNDS = 0.02, 6
#: frames from one search that has not helped to the next one, which double from the first number to the second
PATIENCE, LONGEST = 2.0, 128.0
#: where so many of the points are outliers the body is not in the cloud, and the next frame starts at the last good pose
GONE = 0.5
#: directions in which a body that jumped is looked for
TURNS = 4

next_frame = eqx.filter_jit(track_frame)


class Patience(eqx.Module):
    """When a frame is searched for again, after searches that have not helped."""

    #: frames until the next search is allowed
    wait: float = 0.0
    #: how many they were after the last search
    pause: float = 0.0

    def after(self, good: bool) -> "Patience":
        """One frame later; good frames shorten the pauses again."""
        return Patience(max(self.wait - 1.0, 0.0), 0.5 * self.pause if good else self.pause)

    def after_failure(self) -> "Patience":
        """Double the pause after a search that has not helped."""
        pause = min(max(2.0 * self.pause, PATIENCE), LONGEST)
        return Patience(pause, pause)


class TrackedFrame(eqx.Module):
    """One frame of a tracked sequence."""

    pose: Pose
    statistics: FrameStatistics
    #: the body does not explain the frame, and its pose is not to be trusted
    lost: bool
    #: what is wrong, by part, compared with the frames before
    judgement: Judgement
    #: what the next frame starts from, with the four fields below; all that is needed to go on after a stop
    state: TrackState
    #: pose of the last frame that was not lost, this one among them
    trusted: Pose
    #: what the good frames so far show to be normal
    usual: Usual
    patience: Patience
    #: searches so far, this frame's included
    searches: float

    @property
    def verdict(self) -> str:
        """`good`, `doubtful` or `lost`."""
        return verdict_of(self.lost, self.judgement)

    @property
    def reasons(self) -> tuple[str, ...]:
        """What is wrong and where, such as "unexplained points near the left leg"; empty for a good frame."""
        return reasons_of(self.lost, self.judgement)

    @property
    def unseen(self) -> tuple[str, ...]:
        """Parts without points, by their joints: their pose is a guess, also in a good frame. None are named of a lost frame."""
        return unseen_of(self.lost, self.judgement)


def verdict_of(lost: bool, judgement: Judgement) -> str:
    """Return `good`, `doubtful` or `lost`."""
    return "lost" if lost else judgement.verdict


def reasons_of(lost: bool, judgement: Judgement) -> tuple[str, ...]:
    """Say what is wrong with a frame and where; a lost frame always has a reason."""
    if lost and not judgement.reasons:
        return ("no finite pose",)
    return judgement.reasons


def unseen_of(lost: bool, judgement: Judgement) -> tuple[str, ...]:
    """Name the parts of the body that no points show; none of a lost frame."""
    return () if lost else judgement.unseen


def first_frame(
    tracker: Tracker, surface: JudgedSurface, cloud: Cloud, pose: Pose, sigma: float
) -> TrackedFrame:
    """Track the first frame from a pose near it.

    The deviation falls from `sigma`, over frames that all see the same cloud: the function that tracks is compiled
    anyway. Nothing is known yet of what is usual, and limits are absolute.
    """
    last = min(sigma, FIRST_SIGMA)
    state = start_state(tracker, pose, sigma)
    for level in np.geomspace(sigma, last, FIRST_ROUNDS)[:-1]:
        state, _ = next_frame(tracker, settled(tracker, state, float(level)), cloud)
    state, statistics = next_frame(tracker, settled(tracker, state, last), cloud)
    usual = nothing_usual(surface)
    frame = judge(surface, cloud, settled(tracker, state), statistics, usual, Patience())
    return conclude(tracker, frame, pose)


def judge(
    surface: JudgedSurface,
    cloud: Cloud,
    state: TrackState,
    statistics: FrameStatistics,
    usual: Usual,
    patience: Patience,
    searches: float = 0.0,
) -> TrackedFrame:
    """Compare a frame with what is `usual`, and learn from it where it is good.

    Frames that are doubtful would make their faults usual, one after the other. The first that is not lost has nothing to
    be compared with, and is learned from.
    """
    pose = state.estimate.pose
    judgement, renewed = _compare(surface, usual, pose, cloud)
    lost = judgement.verdict == "lost" or not _finite(pose)
    teaches = not lost and (judgement.verdict == "good" or float(usual.frames) == 0)
    renewed = renewed if teaches else warned(usual)
    return TrackedFrame(pose, statistics, lost, judgement, state, pose, renewed, patience, searches)


@eqx.filter_jit
def _compare(surface: JudgedSurface, usual: Usual, pose: Pose, cloud: Cloud) -> tuple[Judgement, Usual]:
    evidence = gather_evidence(surface, pose, cloud, sensors_of(usual))
    return judge_evidence(surface, usual, evidence), renew(usual, evidence)


def conclude(tracker: Tracker, frame: TrackedFrame, before: Pose) -> TrackedFrame:
    """Settle what the next frame starts from: the last trusted pose, `before`, where the body is not in the cloud at all."""
    patience = frame.patience.after(frame.verdict == "good")
    pose, state = frame.pose, frame.state
    if frame.lost:
        finite = _finite(pose)
        if not finite or not float(frame.statistics.outlier_share) < GONE:
            state = start_state(tracker, before, FIRST_SIGMA)
        pose = pose if finite else before
    trusted = before if frame.lost else pose
    return eqx.tree_at(
        lambda f: (f.pose, f.trusted, f.state, f.patience), frame, (pose, trusted, state, patience)
    )


def wanted(frame: TrackedFrame) -> bool:
    """Whether a frame is to be searched for: it is not good, and no search has just failed."""
    return frame.verdict != "good" and frame.patience.wait <= 0


def better(found: TrackedFrame, frame: TrackedFrame) -> TrackedFrame:
    """Choose between two poses of one frame: `found` where it is likelier and leaves less that is wrong."""
    likelier = not float(frame.statistics.log_likelihood) > float(found.statistics.log_likelihood)
    return found if likelier and found.judgement.worst < frame.judgement.worst else frame


def recover(
    tracker: Tracker,
    surface: JudgedSurface,
    coarse: Tracker,
    frame: TrackedFrame,
    usual: Usual,
    before: Pose,
    cloud: Cloud,
    key: PRNGKeyArray,
    up: tuple[float, float, float] = (0.0, 1.0, 0.0),
) -> TrackedFrame:
    """Search for a frame, which was compared with `usual`, from many starts (Kineben, section 6, "global refinement").

    Starts are neighbours of the frame's own pose and of the last trusted one, `before`, whole and limb by limb, and the latter
    moved to the cloud's middle and turned about `up`, for a body that jumped. The pose that is found is taken where
    it is likelier and leaves less that is wrong.
    """
    failed = eqx.tree_at(
        lambda f: (f.patience, f.searches), frame, (frame.patience.after_failure(), frame.searches + 1.0)
    )
    skeleton = tracker.body.skeleton
    few = thin_cloud(cloud, COARSE_POINTS)
    if not float(jnp.sum(few.weights)) > 0:
        return failed
    wide = tangent_deviations(skeleton, 0.05, 0.5)
    here = _stack(*([frame.pose] if _finite(frame.pose) else []), before)
    keys = jax.random.split(key, 3)
    starts = _join(
        perturbed_starts(skeleton, here, 7, wide, keys[0]),
        subtree_starts(skeleton, here, 7, wide, keys[1]),
        turned_starts(coarse, few, before, TURNS, jnp.asarray(up, before.rotations.dtype)),
    )
    sigmas = jnp.asarray(np.repeat(FINE, 2), frame.pose.rotations.dtype)
    poses, _ = anneal_all(coarse, few, starts, sigmas)
    pose, _ = refine(tracker, cloud, jax.tree.map(lambda leaf: leaf[:1], poses), 7, keys[2])
    state, _ = next_frame(tracker, start_state(tracker, pose, 0.02), cloud)
    state, statistics = next_frame(tracker, settled(tracker, state), cloud)
    patience = Patience(0.0, frame.patience.pause)
    found = judge(surface, cloud, settled(tracker, state), statistics, usual, patience, frame.searches + 1.0)
    if better(found, frame) is frame:
        return failed
    # a better pose that is not good either is searched for no sooner
    return found if found.verdict == "good" else eqx.tree_at(lambda f: f.patience, found, failed.patience)


def _finite(pose: Pose) -> bool:
    return all(bool(jnp.isfinite(leaf).all()) for leaf in jax.tree.leaves(pose))


def _stack(*poses: Pose) -> Pose:
    return jax.tree.map(lambda *leaves: jnp.stack(leaves), *poses)


def _join(*stacks: Pose) -> Pose:
    return jax.tree.map(lambda *leaves: jnp.concatenate(leaves), *stacks)


def settled(tracker: Tracker, state: TrackState, sigma: float | None = None) -> TrackState:
    """The same state with nothing known of how the body moves, and with a deviation that the
    next frame is to start with."""
    estimate = state.estimate
    if sigma is not None:
        level = jnp.asarray(sigma, estimate.sigma.dtype) / tracker.sigma_growth
        estimate = Estimate(estimate.pose, level, estimate.priors)
    return TrackState(estimate, jnp.zeros_like(state.change))
