"""Observations of sensors: point clouds, scans, mesh sequences and optical markers."""

from collections import Counter
from collections.abc import Sequence
from typing import NamedTuple, overload

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from .arguments import (
    as_jax_array,
    as_real_array,
    check_fields,
    check_length,
    check_metres,
    check_rate,
    checked,
    describe,
)
from .errors import InputError
from .geometry.morton_order import spatial_order
from .geometry.normals import estimate_normals
from .geometry.stacking import stack
from .value_checks import check_faces

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


class MeshSequence(eqx.Module):
    """A surface in motion: meshes with the same vertices in the same order, metres.

    NumPy arrays are accepted and become JAX arrays. An integer index returns the vertices of a mesh,
    `(V, 3)`; a slice or an array of indices a shorter sequence.
    """

    vertices: Float[Array, "F V 3"] = eqx.field(converter=as_jax_array)
    #: counter-clockwise as seen from outside
    faces: Int[Array, "T 3"] = eqx.field(converter=as_jax_array)
    #: meshes per second
    rate: float = eqx.field(static=True, default=30.0)

    def __check_init__(self):
        check_fields(self)
        check_rate("MeshSequence", self.rate)
        check_faces("MeshSequence", self.faces, self.vertices.shape[1])

    def __len__(self) -> int:
        return self.vertices.shape[0]

    @overload
    def __getitem__(self, frames: int | np.integer) -> Float[Array, "V 3"]: ...
    @overload
    def __getitem__(self, frames: slice | np.ndarray) -> "MeshSequence": ...
    def __getitem__(self, frames):
        if isinstance(frames, (int, np.integer)):
            if not -len(self) <= frames < len(self):
                raise IndexError(f"There is no mesh {frames} in a sequence of {len(self)} meshes.")
            return self.vertices[frames]
        step = abs(frames.step or 1) if isinstance(frames, slice) else 1
        return MeshSequence(self.vertices[frames], self.faces, self.rate / step)


class MarkerFrames(eqx.Module):
    """Positions of optical markers over time, metres; the position of an occluded marker is zero.

    NumPy arrays are accepted and become JAX arrays. A slice or an array of indices selects frames.
    `make_markers` checks its input and accepts NaN for occluded markers.
    """

    positions: Float[Array, "F M 3"] = eqx.field(converter=as_jax_array)
    visible: Bool[Array, "F M"] = eqx.field(converter=as_jax_array)
    labels: tuple[str, ...] = eqx.field(static=True)
    #: frames per second
    rate: float = eqx.field(static=True, default=100.0)

    def __check_init__(self):
        lengths = check_fields(self)
        check_length(self, "labels", len(self.labels), lengths, "M")
        check_rate("MarkerFrames", self.rate)

    def __len__(self) -> int:
        return self.positions.shape[0]

    def __getitem__(self, frames: slice | np.ndarray) -> "MarkerFrames":
        step = abs(frames.step or 1) if isinstance(frames, slice) else 1
        return MarkerFrames(self.positions[frames], self.visible[frames], self.labels, self.rate / step)


@checked
def make_markers(positions, labels, rate: float, *, name: str = "the markers") -> MarkerFrames:
    """Create checked `MarkerFrames`; a marker with NaN in any coordinate is occluded in that frame.

    **Arguments:** `positions (F, M, 3)` metres; `labels`, a name for each marker; `rate`, frames per second;
    `name` for messages.

    **Raises:** `InputError` with one sentence for another shape, no frames, no markers, labels too many,
    too few, empty or duplicate, a position that is infinite, positions that cannot be in metres, and a rate
    that is not above zero.
    """
    labels = tuple(str(label) for label in labels)
    single = getattr(positions, "dtype", None) == np.float32
    positions = np.asarray(positions) if single else as_real_array("make_markers", "positions", positions)
    if positions.ndim != 3 or positions.shape[2] != 3:
        raise InputError(f"{name} have an array of shape {positions.shape}; expected (F, M, 3).")
    if positions.shape[1] == 0:
        raise InputError(f"{name}: there are no markers; give at least one.")
    if len(positions) == 0:
        raise InputError(f"{name}: there are no frames; give at least one.")
    if len(labels) != positions.shape[1]:
        raise InputError(
            f"{name}: {positions.shape[1]} markers have {len(labels)} labels; expected one for each marker."
        )
    twice = [label for label, count in Counter(labels).items() if count > 1]
    if twice or "" in labels:
        what = f"two markers have the label '{twice[0]}'" if twice else "a marker has an empty label"
        raise InputError(f"{name}: {what}; give each marker a unique label.")
    if not (np.isfinite(rate) and rate > 0):
        raise InputError(f"{name}: `rate` is {rate} frames per second; expected a finite number above 0.")
    infinite = np.argwhere(np.isinf(positions))
    if len(infinite):
        raise InputError(
            f"{name}: marker '{labels[infinite[0, 1]]}' has an infinite coordinate; use NaN for an "
            "occluded marker."
        )
    seen = np.asarray(~np.isnan(positions).any(2))
    # relative to the median of each frame, as people walk far
    shown = np.where(seen[..., None], positions, np.nan)[seen.any(1)]
    shown = shown - np.nanmedian(shown, 1, keepdims=True)
    check_metres("make_markers", "positions", shown[~np.isnan(shown).any(2)])
    return MarkerFrames(np.where(seen[..., None], positions, 0), seen, labels, float(rate))


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
    normals = estimate_normals(points) if normals is None else as_real_array("make_cloud", "normals", normals)
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
    points: Float[np.ndarray, "N 3"], normals: Float[np.ndarray, "N 3"], weights: Float[np.ndarray, "N"]
) -> Cloud:
    """Create a cloud from arrays, in the order and with the padding of `make_cloud`, unchecked and of any
    unit."""
    order = spatial_order(points, weights)
    points, normals, weights = points[order], normals[order], weights[order]
    extra = padded_size(len(points)) - len(points)
    # padding repeats the first point, so that bounding boxes do not change
    return Cloud(
        jnp.asarray(np.concatenate([points, np.repeat(points[:1], extra, 0)])),
        jnp.asarray(np.pad(normals, ((0, extra), (0, 0)))),
        jnp.asarray(np.pad(weights, (0, extra))),
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

    def __init__(self, frames: "Cloud | Sequence[Cloud | Scan]"):
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
    """Stack clouds of one or several sizes into one with a leading axis of frames."""
    frames: list[Cloud] = CloudFrames(clouds)[:]
    if not frames:
        raise InputError("stack_clouds: `clouds` is empty; expected at least one cloud.")
    size = max(cloud.points.shape[0] for cloud in frames)

    def padded(leaf):
        return jnp.pad(leaf, ((0, size - leaf.shape[0]),) + ((0, 0),) * (leaf.ndim - 1), mode="edge")

    return Cloud(
        stack([padded(cloud.points) for cloud in frames]),
        stack([padded(cloud.normals) for cloud in frames]),
        stack([jnp.pad(cloud.weights, (0, size - cloud.weights.shape[0])) for cloud in frames]),
    )


def thin_cloud(cloud: Cloud, count: int, seed: int = 0) -> Cloud:
    """Sample `count` points of one frame at random by weight, padded as in `make_cloud`.

    The sample of a cloud without points is only padding.
    """
    weights = np.asarray(cloud.weights, float)
    size, there = padded_size(count), int((weights > 0).sum())
    likely = weights / weights.sum() if there else None
    chosen = np.random.default_rng(seed).choice(len(weights), min(count, there), replace=False, p=likely)
    padding = size - len(chosen)
    index = np.pad(np.sort(chosen), (0, padding), mode="edge") if there else np.zeros(size, int)
    kept = jnp.asarray(np.arange(size) < len(chosen), cloud.weights.dtype)
    return Cloud(cloud.points[index], cloud.normals[index], kept)
