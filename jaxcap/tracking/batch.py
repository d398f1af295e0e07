"""Tracking and fitting of many clouds at once, as pure functions of arrays."""

from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec
from jaxtyping import Array, Float

from ..arguments import checked
from ..batched_map import map_batches
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
    devices: Sequence[jax.Device] | None = None,  # pyright: ignore[reportInvalidTypeForm]
) -> tuple[Pose, FrameStatistics]:
    """Fit many independent clouds `(B, N, ...)`, also a list of them, or sequences `(B, F, N, ...)` at once.

    **Arguments:** `starts` poses stacked over B, or as a motion; `sigma` initial standard deviation, metres;
    `batch_size` number of clouds in a vectorised loop, one after the other where not given, which is the
    fastest on a CPU; `devices`, such as `jax.local_devices()`, divide the clouds among them, each with as many as the others, so
    that nothing is sent between them. Results differ from those of one device by rounding only.

    Returns poses and statistics, stacked as the clouds are; with `devices` they stay on these. Raises `InputError` for
    other shapes, or an empty list of devices.
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
    if devices is None:
        return _fit_batch(tracker, starts, clouds, jnp.asarray(sigma), batch_size)
    if not devices:
        raise InputError("fit_batch: `devices` is empty; give some, such as jax.local_devices().")
    count = len(starts.rotations)
    mesh = Mesh(np.array(devices), (_BATCH,))
    # each device has as many clouds: the last ones are repeated
    rows = np.minimum(np.arange(-(-count // len(devices)) * len(devices)), count - 1)
    split = NamedSharding(mesh, PartitionSpec(_BATCH))
    divided_starts, divided_clouds = jax.tree.map(
        lambda leaf: jax.device_put(leaf[rows], split), (starts, clouds)
    )
    found = _fit_on_devices(tracker, divided_starts, divided_clouds, jnp.asarray(sigma), batch_size, mesh)
    return jax.tree.map(lambda leaf: leaf[:count], found)


#: axis of the mesh of devices
_BATCH = "batch"


@eqx.filter_jit
def _fit_on_devices(
    tracker: Tracker, starts: Pose, clouds: Cloud, sigma: Float[Array, ""], batch_size, mesh: Mesh
):
    """Fit the clouds of each device in a loop of its own."""
    arrays, static = eqx.partition(tracker, eqx.is_array)

    def of_device(arrays, sigma, starts, clouds):
        return _fit_batch(eqx.combine(arrays, static), starts, clouds, sigma, batch_size)

    same, split = PartitionSpec(), PartitionSpec(_BATCH)
    divided = jax.shard_map(
        of_device, mesh=mesh, in_specs=(same, same, split, split), out_specs=split, check_vma=False
    )
    return divided(arrays, sigma, starts, clouds)


@eqx.filter_jit
def _fit_batch(tracker: Tracker, starts: Pose, clouds: Cloud, sigma: Float[Array, ""], batch_size):
    def sequence(pair):
        start, cloud = pair
        alone = cloud.points.ndim == 2
        stacked = jax.tree.map(lambda leaf: leaf[None], cloud) if alone else cloud
        _, out = scan_track(tracker, start_state(tracker, start, sigma), stacked)
        return jax.tree.map(lambda leaf: leaf[0], out) if alone else out

    return map_batches(sequence, (starts, clouds), batch_size)
