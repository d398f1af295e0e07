"""Track whole sequences: the first frame, lost frames, streams and batches."""

import warnings
from collections.abc import Iterable, Iterator

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import PRNGKeyArray

from ..body.body import Body
from ..body.pose import Motion, Pose, rest_pose, stack_poses
from ..energy.prior import tangent_deviations
from ..observe import Cloud, thin_cloud
from .check import check_cloud
from .em import Estimate, FrameStatistics
from .initialise import (
    COARSE_POINTS,
    FINE,
    anneal_all,
    coarse_tracker,
    initialise,
    perturbed_starts,
    refine,
    subtree_starts,
)
from .track import Tracker, TrackState, make_tracker, start_state, track_frame

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

_track_frame = eqx.filter_jit(track_frame)


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


def track_frames(
    tracker: Tracker,
    clouds: Iterable[Cloud],
    start: Pose | TrackedFrame | None = None,
    *,
    search: bool = False,
    sigma: float = 0.1,
    up: tuple[float, float, float] = (0.0, 1.0, 0.0),
    first: int = 0,
) -> Iterator[TrackedFrame]:
    """Track a stream of clouds; yields a frame as soon as it is done.

    **Arguments:** `start` is the pose to begin at, rest where not given, or the last
    `TrackedFrame` of a run that was stopped; with `search` the first pose is found by
    `initialise`; `sigma` metres is the deviation that the first frame starts with
    (Kineben's sigma0); `up` is the vertical of the scene; `first` is the number of the first
    cloud, so that a run that goes on searches as it would have.

    A frame that its forerunner does not lead to is searched for by many perturbed starts
    side by side; where none explains the cloud it is marked `lost`, and tracking goes on.
    """
    coarse = None
    frame = start if isinstance(start, TrackedFrame) else None
    for number, cloud in enumerate(clouds, first):
        if frame is None:
            pose = rest_pose(tracker.body.skeleton) if start is None else start
            if search:
                coarse = coarse_tracker(tracker)
                pose, _ = initialise(tracker, cloud, up=up, coarse=coarse)
                sigma = 0.03
            frame = _first_frame(tracker, cloud, pose, sigma)
        else:
            state, statistics = _track_frame(tracker, frame.state, cloud)
            frame = _judge(frame.usual, state, statistics)
        if _doubtful(frame):
            coarse = coarse_tracker(tracker) if coarse is None else coarse
            frame = _recover(tracker, coarse, frame, cloud, jax.random.key(number))
        yield frame


def track(
    body: Body,
    clouds: Iterable[Cloud],
    start: Pose | None = None,
    *,
    rate: float = 30.0,
    tracker: Tracker | None = None,
    search: bool = False,
) -> Motion:
    """The motion of a body through a sequence of clouds (Kineben, section 3.3).

    **Arguments:** `clouds` from `make_cloud`, one a frame; `start` a pose near that of the first
    frame, or `search=True`; `rate` frames a second; `tracker` for other settings than the
    usual. Lost frames are named in a warning; `track_frames` tells more about each frame.

    **Raises:** `InputError` for a cloud with fewer points than the pose has parameters, or in
    another unit.
    """
    tracker = make_tracker(body) if tracker is None else tracker
    checked = (_checked(body, number, cloud) for number, cloud in enumerate(clouds))
    frames = list(track_frames(tracker, checked, start, search=search))
    lost = [number for number, frame in enumerate(frames) if frame.lost]
    if lost:
        warnings.warn(
            f"{len(lost)} of {len(frames)} frames are lost: {', '.join(map(str, lost[:20]))}.", stacklevel=2
        )
    return stack_poses([frame.pose for frame in frames], rate)


def _checked(body: Body, number: int, cloud: Cloud) -> Cloud:
    check_cloud(body, cloud, f"cloud {number}")
    return cloud


def scan_track(
    tracker: Tracker, state: TrackState, clouds: Cloud
) -> tuple[TrackState, tuple[Pose, FrameStatistics]]:
    """Track clouds stacked over frames `(F, N, ...)` in one `lax.scan`: pure, for use under
    `jit` and for batches. Nothing is searched for; judge the statistics."""

    def step(state, cloud):
        state, statistics = track_frame(tracker, state, cloud)
        return state, (state.estimate.pose, statistics)

    return jax.lax.scan(step, state, clouds)


@eqx.filter_jit
def fit_batch(
    tracker: Tracker, starts: Pose, clouds: Cloud, *, sigma: float = 0.1, batch_size: int | None = None
) -> tuple[Pose, FrameStatistics]:
    """Fit many independent clouds `(B, N, ...)` or sequences `(B, F, N, ...)` at once.

    **Arguments:** `starts` poses stacked over B; `sigma` metres to start with;
    `batch_size` how many go side by side in a vectorised loop, one after the other where not
    given, which is the fastest on a CPU.

    Returns poses and statistics, stacked as the clouds are.
    """

    def sequence(pair):
        start, cloud = pair
        alone = cloud.points.ndim == 2
        stacked = jax.tree.map(lambda leaf: leaf[None], cloud) if alone else cloud
        _, out = scan_track(tracker, start_state(tracker, start, sigma), stacked)
        return jax.tree.map(lambda leaf: leaf[0], out) if alone else out

    return jax.lax.map(sequence, (starts, clouds), batch_size=batch_size)


def _first_frame(tracker: Tracker, cloud: Cloud, pose: Pose, sigma: float) -> TrackedFrame:
    """The deviation falls from `sigma`, over frames that all see the same cloud: the function that
    tracks is compiled anyway. Nothing is known yet of what is usual."""
    state, statistics = start_state(tracker, pose, sigma), None
    for level in np.geomspace(sigma, min(sigma, FIRST_SIGMA), FIRST_ROUNDS):
        state, statistics = _track_frame(tracker, _settled(tracker, state, float(level)), cloud)
    assert statistics is not None
    share = float(statistics.outlier_share)
    expected = float(tracker.mixture.outlier) + FIRST_SHARE - LOST_SHARE
    lost = _judge((-np.inf, expected, 0.0), state, statistics).lost
    usual = float(statistics.log_likelihood), share, 0.0
    return TrackedFrame(state.estimate.pose, statistics, lost, _settled(tracker, state), usual)


def _judge(usual: tuple[float, float, float], state: TrackState, statistics: FrameStatistics) -> TrackedFrame:
    """Whether a frame is explained about as well as those before it."""
    likelihood, share = float(statistics.log_likelihood), float(statistics.outlier_share)
    level, level_share, wait = usual
    explained = share < level_share + LOST_SHARE and float(statistics.sigma) < LOST_SIGMA
    lost = not (explained and np.isfinite(likelihood))
    if likelihood > level - DOUBT and not lost:
        level, level_share = 0.9 * level + 0.1 * likelihood, 0.9 * level_share + 0.1 * share
    usual = (level, level_share, max(wait - 1.0, 0.0))
    return TrackedFrame(state.estimate.pose, statistics, lost, state, usual)


def _doubtful(frame: TrackedFrame) -> bool:
    level, level_share, wait = frame.usual
    statistics = frame.statistics
    fallen = not float(statistics.log_likelihood) > level - DOUBT
    far = not float(statistics.sigma) < CLOSE
    missing = not float(statistics.outlier_share) < level_share + MISSING
    return frame.lost or (wait <= 0 and fallen and (far or missing))


def _recover(
    tracker: Tracker, coarse: Tracker, frame: TrackedFrame, cloud: Cloud, key: PRNGKeyArray
) -> TrackedFrame:
    """Many perturbed starts side by side (Kineben, section 6, "global refinement")."""
    skeleton = tracker.body.skeleton
    wide = tangent_deviations(skeleton, 0.05, 0.5)
    here = jax.tree.map(lambda leaf: leaf[None], frame.pose)
    keys = jax.random.split(key, 3)
    few = thin_cloud(cloud, COARSE_POINTS)
    starts = perturbed_starts(skeleton, here, 15, wide, keys[0])
    limbs = subtree_starts(skeleton, here, 15, wide, keys[1])
    starts = jax.tree.map(lambda a, b: jnp.concatenate([a, b]), starts, limbs)
    sigmas = jnp.asarray(np.repeat(FINE, 2), frame.pose.rotations.dtype)
    poses, _ = anneal_all(coarse, few, starts, sigmas)
    pose, _ = refine(tracker, cloud, jax.tree.map(lambda leaf: leaf[:1], poses), 7, keys[2])
    state, _ = _track_frame(tracker, start_state(tracker, pose, 0.02), cloud)
    state, statistics = _track_frame(tracker, _settled(tracker, state), cloud)
    found = _judge(frame.usual, _settled(tracker, state), statistics)
    gain = float(statistics.log_likelihood) - float(frame.statistics.log_likelihood)
    if gain > 0 or not np.isfinite(float(frame.statistics.sigma)):
        return found
    # what no search betters is the new usual, unless the frame is lost
    level, level_share, _ = frame.usual
    if not frame.lost:
        level = float(frame.statistics.log_likelihood)
    waiting = level, level_share, float(PATIENCE)
    return TrackedFrame(frame.pose, frame.statistics, frame.lost, frame.state, waiting)


def _settled(tracker: Tracker, state: TrackState, sigma: float | None = None) -> TrackState:
    """The same state with nothing known of how the body moves, and with a deviation that the
    next frame is to start with."""
    estimate = state.estimate
    if sigma is not None:
        level = jnp.asarray(sigma, estimate.sigma.dtype) / tracker.sigma_growth
        estimate = Estimate(estimate.pose, level, estimate.priors)
    return TrackState(estimate, jnp.zeros_like(state.change))
