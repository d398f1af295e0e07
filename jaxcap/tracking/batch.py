"""Tracking and fitting of many clouds at once, as pure functions of arrays."""

from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..arguments import checked
from ..body.pose import Motion, Pose
from ..errors import InputError
from ..observe import Scan, stack_clouds
from ..observe.clouds import Cloud
from .expectation_maximisation.em_step import FrameStatistics
from .track_frame import Tracker, TrackState, check_sigma, start_state, track_frame


@checked
def scan_track(
    tracker: Tracker, state: TrackState, clouds: Cloud | Sequence[Cloud | Scan]
) -> tuple[TrackState, tuple[Pose, FrameStatistics]]:
    """Track clouds stacked over frames `(F, N, ...)` in one `lax.scan`: pure, for use under `jit` and for
    batches.

    Lost frames are not searched for; judge the statistics.
    """

    clouds = clouds if isinstance(clouds, Cloud) else stack_clouds(clouds)

    def step(state, cloud):
        state, statistics = track_frame(tracker, state, cloud)
        return state, (state.estimate.pose, statistics)

    return jax.lax.scan(step, state, clouds)


@checked
def fit_batch(
    tracker: Tracker,
    starts: Pose | Motion,
    clouds: Cloud | Sequence[Cloud | Scan],
    *,
    sigma: float | Float[Array, ""] = 0.1,
    batch_size: int | None = None,
) -> tuple[Pose, FrameStatistics]:
    """Fit many independent clouds `(B, N, ...)`, also a list of them, or sequences `(B, F, N, ...)` at once.

    **Arguments:** `starts` poses stacked over B, or as a motion; `sigma` initial standard deviation, metres;
    `batch_size` number of clouds in a vectorised loop, one after the other where not given, which is the
    fastest on a CPU.

    Returns poses and statistics, stacked as the clouds are.
    """
    check_sigma("fit_batch", sigma)
    starts = starts.poses if isinstance(starts, Motion) else starts
    clouds = clouds if isinstance(clouds, Cloud) else stack_clouds(clouds)
    if starts.rotations.ndim != 3 or starts.rotations.shape[0] != clouds.points.shape[0]:
        raise InputError(
            f"{clouds.points.shape[0]} clouds or sequences were given, but starts of shape "
            f"{starts.rotations.shape}; expected one start for each, stacked (B, J, 4), such as "
            "stack_poses(...).poses."
        )
    return _fit_batch(tracker, starts, clouds, jnp.asarray(sigma), batch_size)


@eqx.filter_jit
def _fit_batch(tracker: Tracker, starts: Pose, clouds: Cloud, sigma: Float[Array, ""], batch_size):
    def sequence(pair):
        start, cloud = pair
        alone = cloud.points.ndim == 2
        stacked = jax.tree.map(lambda leaf: leaf[None], cloud) if alone else cloud
        _, out = scan_track(tracker, start_state(tracker, start, sigma), stacked)
        return jax.tree.map(lambda leaf: leaf[0], out) if alone else out

    return jax.lax.map(sequence, (starts, clouds), batch_size=batch_size)
