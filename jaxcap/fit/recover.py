"""Judge tracked frames, and search for those that their forerunner did not lead to."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import PRNGKeyArray

from ..body.pose import Pose
from ..energy.prior import tangent_deviations
from ..observe import Cloud, thin_cloud
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
from .track import Tracker, TrackState, start_state, track_frame

#: a fall of a frame's mean log-likelihood below the usual that is worth a search, unless points
#: lie within `CLOSE` metres of the surface and about as many as usual are explained
DOUBT, CLOSE, MISSING = 0.3, 0.01, 0.015
#: shares of points beyond the usual outliers, or on the first frame beyond the expected ones,
#: that no part explains where a frame is lost; and the deviation in metres
LOST_SHARE, FIRST_SHARE, LOST_SIGMA = 0.04, 0.1, 0.03
#: deviation at the end of a first frame, metres, and rounds to get there
FIRST_SIGMA, FIRST_ROUNDS = 0.02, 6
#: frames until the next search, where one has found nothing better
PATIENCE = 3
#: directions in which a body that jumped is looked for
TURNS = 4

next_frame = eqx.filter_jit(track_frame)


class TrackedFrame(eqx.Module):
    """One frame of a tracked sequence."""

    pose: Pose
    statistics: FrameStatistics
    #: the frame is not explained by the body, and its pose is not to be trusted
    lost: bool
    #: what the next frame starts from; all that is needed to go on after a stop
    state: TrackState
    #: usual log-likelihood and outlier share, by the good frames so far, and how many frames to
    #: wait before the next search
    usual: tuple[float, float, float]


def first_frame(tracker: Tracker, cloud: Cloud, pose: Pose, sigma: float) -> TrackedFrame:
    """The deviation falls from `sigma`, over frames that all see the same cloud: the function that
    tracks is compiled anyway. Nothing is known yet of what is usual."""
    last = min(sigma, FIRST_SIGMA)
    state = start_state(tracker, pose, sigma)
    for level in np.geomspace(sigma, last, FIRST_ROUNDS)[:-1]:
        state, _ = next_frame(tracker, settled(tracker, state, float(level)), cloud)
    state, statistics = next_frame(tracker, settled(tracker, state, last), cloud)
    share = float(statistics.outlier_share)
    expected = float(tracker.mixture.outlier) + FIRST_SHARE - LOST_SHARE
    lost = judge((-np.inf, expected, 0.0), state, statistics).lost
    usual = float(statistics.log_likelihood), share, 0.0
    return TrackedFrame(state.estimate.pose, statistics, lost, settled(tracker, state), usual)


def judge(usual: tuple[float, float, float], state: TrackState, statistics: FrameStatistics) -> TrackedFrame:
    """Whether a frame is explained about as well as those before it."""
    likelihood, share = float(statistics.log_likelihood), float(statistics.outlier_share)
    level, level_share, wait = usual
    explained = share < level_share + LOST_SHARE and float(statistics.sigma) < LOST_SIGMA
    lost = not (explained and np.isfinite(likelihood))
    if likelihood > level - DOUBT and not lost:
        level, level_share = 0.9 * level + 0.1 * likelihood, 0.9 * level_share + 0.1 * share
    usual = (level, level_share, max(wait - 1.0, 0.0))
    return TrackedFrame(state.estimate.pose, statistics, lost, state, usual)


def doubtful(frame: TrackedFrame) -> bool:
    level, level_share, wait = frame.usual
    statistics = frame.statistics
    fallen = not float(statistics.log_likelihood) > level - DOUBT
    far = not float(statistics.sigma) < CLOSE
    missing = not float(statistics.outlier_share) < level_share + MISSING
    return frame.lost or (wait <= 0 and fallen and (far or missing))


def recover(
    tracker: Tracker,
    coarse: Tracker,
    frame: TrackedFrame,
    before: Pose,
    cloud: Cloud,
    key: PRNGKeyArray,
    up: tuple[float, float, float] = (0.0, 1.0, 0.0),
) -> TrackedFrame:
    """Many starts side by side (Kineben, section 6, "global refinement"), and the best goes on:
    neighbours of the frame's own pose and of the one `before`, whole and limb by limb, and
    the latter moved to the cloud's middle and turned about `up`, for a body that jumped.

    Where nothing explains the cloud, the frame is `lost` and the next one starts at `before`.
    """
    skeleton = tracker.body.skeleton
    few = thin_cloud(cloud, COARSE_POINTS)
    if not float(jnp.sum(few.weights)) > 0:
        return _lost(tracker, frame, before)
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
    found = judge(frame.usual, settled(tracker, state), statistics)
    if not float(frame.statistics.log_likelihood) > float(statistics.log_likelihood):
        return _lost(tracker, found, before) if found.lost else found
    if frame.lost:
        return _lost(tracker, frame, before)
    # what no search betters is the new usual
    usual = float(frame.statistics.log_likelihood), frame.usual[1], float(PATIENCE)
    return TrackedFrame(frame.pose, frame.statistics, False, frame.state, usual)


def _lost(tracker: Tracker, frame: TrackedFrame, before: Pose) -> TrackedFrame:
    pose = frame.pose if _finite(frame.pose) else before
    state = start_state(tracker, before, FIRST_SIGMA)
    return TrackedFrame(pose, frame.statistics, True, state, frame.usual)


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
