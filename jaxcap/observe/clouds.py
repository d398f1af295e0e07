"""Point clouds, and scans as read from files."""

from collections.abc import Sequence
from typing import NamedTuple, overload

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ..arguments import as_real_array, check_fields, checked, describe
from ..errors import InputError
from ..geometry.sampling import spatial_order
from ..stacking import device_array, stack, stack_trees, take_rows
from ..value_checks import check_metres
from .depth_views import DepthView
from .planes import estimate_cloud_normals

#: largest distance of a cloud's median from the origin, metres: float32 resolves half a millimetre there
MAX_DISTANCE = 1e4
#: largest valid coordinate in any unit; single ones beyond `MAX_DISTANCE` are outliers
MAX_COORDINATE = 1e9
#: smallest width of a cloud of more than one position, metres
MIN_EXTENT = 5e-3


class Cloud(eqx.Module):
    """Points with unit normals and weights, metres; weight zero means padding.

    One frame is `(N, ...)`. A sequence is a list of clouds, or one cloud with a leading axis of frames,
    `(F, N, ...)`. A normal of zero is unknown.
    """

    points: Float[Array, "*frames N 3"]
    normals: Float[Array, "*frames N 3"]
    weights: Float[Array, "*frames N"]
    #: the depth images that the points come from, if they are known
    views: tuple[DepthView, ...] = ()
    #: the reason why the frame shows no person, a sentence; such a cloud has no points, only padding
    missing: str = eqx.field(static=True, default="")

    def __check_init__(self):
        check_fields(self)


class Scan(NamedTuple):
    """One frame of a file, metres; functions that take clouds convert it by `make_cloud(points, normals)`."""

    name: str
    points: Float[np.ndarray, "N 3"]
    #: normals of the file or of its faces; None where there are none, and they are estimated
    normals: Float[np.ndarray, "N 3"] | None
    #: the triangles of a mesh; empty for a cloud
    faces: Int[np.ndarray, "T 3"]


@checked
def make_cloud(points, normals=None, weights=None, *, name: str = "the cloud") -> Cloud:
    """Create a checked and padded `Cloud`, so that clouds of similar size compile once.

    The points are sorted so that neighbours in space are neighbours in memory, which makes searches faster.

    **Arguments:** `points (N, 3)` metres; `normals (N, 3)` of any length, estimated from the points where
    not given; `weights (N,)`, one where not given; `name` for messages.

    **Raises:** `InputError` with one sentence for an empty cloud, a coordinate that is not finite, a
    negative weight, arrays of different lengths, and points that cannot be in metres or are too far away.
    """
    points = as_real_array("make_cloud", "points", points)
    if points.ndim != 2 or points.shape[1:] != (3,):
        raise InputError(f"{name} has an array of shape {points.shape}; expected (N, 3).")
    if len(points) == 0:
        raise InputError(f"{name} is empty; expected at least one point.")
    bad = np.flatnonzero(~np.isfinite(points).all(1))
    if bad.size:
        raise InputError(
            f"{name} has {bad.size} points that are not finite, first point {bad[0]}; remove them."
        )
    check_metres("make_cloud", "points" if name == "the cloud" else name, points)
    check_coordinates(points, name)
    normals = (
        estimate_cloud_normals(points) if normals is None else as_real_array("make_cloud", "normals", normals)
    )
    weights = np.ones(len(points)) if weights is None else as_real_array("make_cloud", "weights", weights)
    if normals.shape != points.shape or weights.shape != points.shape[:1]:
        raise InputError(
            f"{name} has {len(points)} points, but normals of shape {normals.shape} and weights of "
            f"shape {weights.shape}; expected one normal and one weight for each point."
        )
    if not ((weights >= 0) & np.isfinite(weights)).all():
        raise InputError(
            f"{name} has a weight below zero or not finite; expected finite weights of at least 0."
        )
    return ordered_cloud(points, unit_normals(normals), weights)


@checked
def missing_cloud(reason: str, views: tuple[DepthView, ...] = ()) -> Cloud:
    """Make the cloud of a frame that shows no person, with the `reason`, a sentence.

    Tracking keeps the pose of the frame before. **Arguments:** `views`, blank ones of the cameras, if they are known.
    """
    size = padded_size(1)
    nothing = jnp.zeros((size, 3))
    return Cloud(nothing, nothing, jnp.zeros(size), views, reason)


def check_coordinates(points: Float[np.ndarray, "N 3"], name: str) -> None:
    """Check that points are near enough to the origin for single precision, and that the cloud is not too
    small, metres.

    **Raises:** `InputError` where they are not.
    """
    away, beyond = float(np.abs(np.median(points, axis=0)).max()), float(np.abs(points).max())
    if away > MAX_DISTANCE or beyond > MAX_COORDINATE:
        far = away if away > MAX_DISTANCE else beyond
        raise InputError(
            f"{name} has points {far:.3g} m from the origin; expected at most {MAX_DISTANCE:g} m, as single "
            "precision does not resolve millimetres beyond; check the unit, or subtract the position of "
            "the scene from all points."
        )
    extent = float(np.ptp(points, axis=0).max())
    if 0 < extent < MIN_EXTENT:
        raise InputError(
            f"{name} is {extent:.3g} m wide; expected metres, at least {MIN_EXTENT:g}; check the unit, which "
            "may be kilometres."
        )


def ordered_cloud(
    points: Float[np.ndarray, "N 3"],
    normals: Float[np.ndarray, "N 3"],
    weights: Float[np.ndarray, "N"],
    size: int | None = None,
) -> Cloud:
    """Create a cloud from arrays, in the order and with the padding of `make_cloud`, or padded to `size`; unchecked and of
    any unit."""
    order = spatial_order(points, weights)
    points, normals, weights = points[order], normals[order], weights[order]
    extra = (padded_size(len(points)) if size is None else size) - len(points)
    # padding repeats the first point, so that bounding boxes do not change
    return Cloud(
        device_array(np.concatenate([points, np.repeat(points[:1], extra, 0)])),
        device_array(np.pad(normals, ((0, extra), (0, 0)))),
        device_array(np.pad(weights, (0, extra))),
    )


def unit_normals(normals: Float[np.ndarray, "N 3"]) -> Float[np.ndarray, "N 3"]:
    """Normalise normals to length one; zero, which means unknown, where they have no length or are not
    finite."""
    with np.errstate(over="ignore", invalid="ignore"):
        lengths = np.linalg.norm(normals, axis=1, keepdims=True)
        return np.where(
            np.isfinite(lengths) & (lengths > 0), normals / np.where(lengths > 0, lengths, 1), 0.0
        )


def padded_size(count: int, sizes: Sequence[int] = (64, 80, 96, 112), growth: int = 2) -> int:
    """Find the smallest size of a ladder that is large enough, so that few sizes are compiled.

    The ladder is the ascending `sizes`, then `growth` times each, and so on; by default 64, 80, 96, 112,
    128, 160, ..., four rungs to a doubling.
    """
    scale = 1
    while count > scale * sizes[-1]:
        scale *= growth
    return next(scale * rung for rung in sizes if count <= scale * rung)


class CloudFrames(Sequence[Cloud]):
    """A lazy sequence of clouds from any sequence of frames: clouds and scans, as `read_clouds` returns
    them, or one cloud that is stacked over frames.

    **Raises:** `InputError` where it is none of these.
    """

    # without the types of the items, as a check of them would load a frame
    def __init__(self, frames: "Cloud | Sequence"):
        if isinstance(frames, Cloud) and frames.points.ndim != 3:
            raise InputError(
                "`clouds` is a single cloud; expected a list of clouds, or one cloud stacked over frames "
                "(F, N, 3)."
            )
        if isinstance(frames, Scan) or not (hasattr(frames, "__getitem__") or isinstance(frames, Cloud)):
            raise InputError(f"`clouds` {describe(frames)}; expected a sequence of clouds.")
        self._frames = frames

    def __len__(self) -> int:
        return len(self._frames.points if isinstance(self._frames, Cloud) else self._frames)

    @overload
    def __getitem__(self, index: int) -> Cloud: ...
    @overload
    def __getitem__(self, index: slice) -> list[Cloud]: ...
    def __getitem__(self, index):
        if isinstance(index, slice):
            return [self[frame] for frame in range(len(self))[index]]
        # JAX arrays clamp indices, but iteration ends by an IndexError
        frame = range(len(self))[index]
        if isinstance(self._frames, Cloud):
            return jax.tree.map(lambda leaf: leaf[frame], self._frames)
        return as_cloud(self._frames[frame], frame)


def as_cloud(frame: "Cloud | Scan", number: int = 0) -> Cloud:
    """Convert a frame to a cloud; a cloud is returned unchanged.

    **Raises:** `InputError` where it is neither a cloud nor a scan.
    """
    if isinstance(frame, Scan):
        return make_cloud(frame.points, frame.normals, name=frame.name)
    if not isinstance(frame, Cloud):
        raise InputError(
            f"Cloud {number} {describe(frame)}; expected a Cloud, as make_cloud returns, or a Scan, "
            "as read_clouds returns."
        )
    return frame


@checked
def stack_clouds(clouds: "Sequence[Cloud | Scan]") -> Cloud:
    """Stack clouds of one or several sizes, and their views, into one with a leading axis of frames.

    **Raises:** `InputError` if there are none, or if they have other numbers or sizes of depth images.
    """
    frames: list[Cloud] = CloudFrames(clouds)[:]
    if not frames:
        raise InputError("stack_clouds: `clouds` is empty; expected at least one cloud.")
    for number, cloud in enumerate(frames):
        if cloud.missing:
            raise InputError(f"stack_clouds: cloud {number} has no points: {cloud.missing} Leave it out.")
        shapes = [[view.depth.shape for view in one.views] for one in (frames[0], cloud)]
        if shapes[0] != shapes[1]:
            raise InputError(
                f"stack_clouds: the depth images of cloud {number} have the shapes {shapes[1]}, those of cloud 0 "
                f"{shapes[0]}; give clouds of the same cameras."
            )
    size = max(cloud.points.shape[0] for cloud in frames)

    def padded(leaf):
        return jnp.pad(leaf, ((0, size - leaf.shape[0]),) + ((0, 0),) * (leaf.ndim - 1), mode="edge")

    return Cloud(
        stack([padded(cloud.points) for cloud in frames]),
        stack([padded(cloud.normals) for cloud in frames]),
        stack([jnp.pad(cloud.weights, (0, size - cloud.weights.shape[0])) for cloud in frames]),
        stack_trees([cloud.views for cloud in frames]),
    )


@checked
def thin_cloud(cloud: Cloud, count: int, seed: int = 0) -> Cloud:
    """Sample `count` points of one frame at random by weight, padded as in `make_cloud`.

    The sample of a cloud without points is only padding.
    """
    weights = np.asarray(cloud.weights, float)
    size, num_points = padded_size(count), int((weights > 0).sum())
    likely = weights / weights.sum() if num_points else None
    chosen = np.random.default_rng(seed).choice(len(weights), min(count, num_points), replace=False, p=likely)
    padding = size - len(chosen)
    index = np.pad(np.sort(chosen), (0, padding), mode="edge") if num_points else np.zeros(size, int)
    kept = device_array(np.arange(size) < len(chosen), cloud.weights.dtype)
    points, normals = take_rows((cloud.points, cloud.normals), index)
    return Cloud(points, normals, kept, cloud.views)
