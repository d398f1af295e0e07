"""Fusion of depth images of several cameras in one cloud or one mesh."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from ..geometry.camera import Camera
from .back_projection import camera_rays, measured_points


class FusedScan(NamedTuple):
    """A scan of one frame, metres."""

    points: Float[np.ndarray, "N 3"]
    #: unit, towards the camera; zero for points with too few neighbouring pixels
    normals: Float[np.ndarray, "N 3"]
    #: number of the camera that saw a point
    views: Int[np.ndarray, "N"]
    #: counter-clockwise as the camera sees them; none for a cloud
    faces: Int[np.ndarray, "F 3"]


def fuse_cloud(
    cameras: Sequence[Camera],
    depths: Sequence[Float[np.ndarray, "H W"]],
    gap: float = 0.03,
    window: int = 2,
    voxel: float = 0.0,
) -> FusedScan:
    """Fuse the measured pixels of all views in one cloud.

    **Arguments:** `depths`, an image for each camera, metres, zero for pixels without measurement; `gap` and
    `window` as for `image_normals`; `voxel`, the side of the cubes that keep one point each, metres, 0 for
    none.
    """
    views = [
        (*_world(camera, depth, gap, window), np.full(np.count_nonzero(depth), number))
        for number, (camera, depth) in enumerate(zip(cameras, depths, strict=True))
    ]
    points, normals, numbers = (np.concatenate(parts) for parts in zip(*views, strict=True))
    if voxel > 0 and len(points):
        points, normals, numbers = average_in_voxels(points, normals, numbers, voxel)
    return FusedScan(points, normals, numbers, np.zeros((0, 3), int))


def fuse_mesh(
    cameras: Sequence[Camera],
    depths: Sequence[Float[np.ndarray, "H W"]],
    gap: float = 0.03,
    window: int = 2,
) -> FusedScan:
    """Fuse the measured pixels of all views in one mesh: the grids of pixels, cut at discontinuities.

    Grids of different views overlap and are not merged. Pixels of no triangle are left out.
    """
    cloud, faces, first = fuse_cloud(cameras, depths, gap, window), [], 0
    for depth in depths:
        faces.append(grid_faces(depth, gap) + first)
        first += np.count_nonzero(depth)
    triangles = np.concatenate(faces)
    used = np.unique(triangles)
    number = np.zeros(len(cloud.points), int)
    number[used] = np.arange(len(used))
    return FusedScan(cloud.points[used], cloud.normals[used], cloud.views[used], number[triangles])


def grid_faces(depth: Float[np.ndarray, "H W"], gap: float) -> Int[np.ndarray, "F 3"]:
    """Triangulate neighbouring measured pixels with depths that differ by at most `gap`, metres.

    A square of four such pixels has two triangles, one of three such pixels has one. Indices count measured
    pixels row by row.
    """
    number = np.cumsum(depth.reshape(-1) > 0).reshape(depth.shape) - 1
    squares, depths = (
        np.stack([a[:-1, :-1], a[1:, :-1], a[1:, 1:], a[:-1, 1:]], -1).reshape(-1, 4) for a in (number, depth)
    )
    # counter-clockwise, as rows go down
    first, second, third, fourth = [0, 1, 2], [0, 2, 3], [1, 2, 3], [0, 1, 3]
    cut = _is_continuous(depths[:, first], gap) | _is_continuous(depths[:, second], gap)
    faces = [squares[_is_continuous(depths[:, corners], gap)][:, corners] for corners in (first, second)]
    # squares without a triangle on one diagonal may have one on the other
    faces += [
        squares[_is_continuous(depths[:, corners], gap) & ~cut][:, corners] for corners in (third, fourth)
    ]
    return np.concatenate(faces)


def image_normals(
    camera: Camera, depth: Float[np.ndarray, "H W"], gap: float, window: int
) -> Float[np.ndarray, "P 3"]:
    """Estimate unit normals of the measured pixels, row by row, in the camera's frame and towards it.

    The inverse depth of a plane is linear in an image. A plane through a pixel and its neighbours, `window`
    rows and columns around, is therefore a linear least-squares fit. Pixels that are farther or nearer by
    more than `gap`, metres, are excluded. Normals are zero if fewer than three pixels are left, or if these
    are collinear.
    """
    n, u, v, uu, uv, vv, w, wu, wv = _plane_sums(depth, gap, window)
    fx, fy = np.asarray(camera.focal, float)
    # centre the sums, so that two unknowns are left
    count = np.maximum(n, 1.0)
    uu, uv, vv = uu - u * u / count, uv - u * v / count, vv - v * v / count
    wu, wv = wu - w * u / count, wv - w * v / count
    spread = uu * vv - uv * uv
    known = (n >= 3) & (spread > 1e-9)
    safe = np.where(known, spread, 1.0)
    slope = np.stack([(wu * vv - wv * uv) / safe * fx, (wv * uu - wu * uv) / safe * fy], 1)
    rays = camera_rays(camera)[depth > 0]
    level = (w - slope[:, 0] / fx * u - slope[:, 1] / fy * v) / count
    normals = np.concatenate([slope, (level - np.sum(slope * rays[:, :2], 1))[:, None]], 1)
    normals *= np.where(np.sum(normals * rays, 1) > 0, -1.0, 1.0)[:, None]
    lengths = np.linalg.norm(normals, axis=1)
    return np.where(
        (known & (lengths > 0))[:, None], normals / np.where(lengths > 0, lengths, 1.0)[:, None], 0.0
    )


def _plane_sums(depth: Float[np.ndarray, "H W"], gap: float, window: int) -> Float[np.ndarray, "9 P"]:
    """Sum over the neighbours of each measured pixel: 1, u, v, u^2, uv, v^2, w, wu and wv.

    `u` and `v` are the columns and rows from the pixel, `w` the inverse depth. Only the box around the measured pixels is
    visited.
    """
    measured = depth > 0
    if not measured.any():
        return np.zeros((9, 0))
    rows, columns = (np.flatnonzero(measured.any(axis)) for axis in (1, 0))
    box = np.s_[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
    here = depth[box]
    framed = np.pad(here, window)
    inverses = np.divide(1.0, framed, out=np.zeros_like(framed), where=framed > 0)
    sums, (height, width) = np.zeros((9, *here.shape), here.dtype), here.shape
    for down in range(-window, window + 1):
        # of one row of neighbours: 1, u, u^2, w and wu
        row = np.zeros((5, *here.shape), here.dtype)
        for across in range(-window, window + 1):
            there = np.s_[window + down : window + down + height, window + across : window + across + width]
            near = ((framed[there] > 0) & (np.abs(framed[there] - here) < gap)).astype(here.dtype)
            inverse = inverses[there] * near
            row[0] += near
            row[3] += inverse
            if across:
                row[1] += across * near
                row[2] += across**2 * near
                row[4] += across * inverse
        count, u, uu, w, wu = row
        parts = (count, u, down * count, uu, down * u, down**2 * count, w, wu, down * w)
        for total, part in zip(sums, parts, strict=True):
            total += part
    return sums[:, measured[box]]


def _world(camera: Camera, depth: np.ndarray, gap: float, window: int) -> tuple[np.ndarray, np.ndarray]:
    """Compute points and normals of the measured pixels, row by row, in world coordinates."""
    normals = image_normals(camera, depth, gap, window) @ np.asarray(camera.rotation, float)
    return measured_points(camera, depth), normals


def _is_continuous(depths: np.ndarray, gap: float) -> np.ndarray:
    """Test if all corners `(Q, K)` are measured and their depths differ by at most `gap`."""
    nearest, farthest = depths.min(1), depths.max(1)
    return (nearest > 0) & (farthest - nearest <= gap)


def average_in_voxels(
    points: np.ndarray, normals: np.ndarray, views: np.ndarray, side: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Average points and normals in each cube, with the view of the cube's first point."""
    _, first, cell = np.unique(cell_numbers(points, side), return_index=True, return_inverse=True)
    count = len(first)
    total = np.stack([np.bincount(cell, a, count) for a in np.concatenate([points, normals], 1).T], 1)
    means = total[:, :3] / np.bincount(cell, minlength=count)[:, None]
    lengths = np.linalg.norm(total[:, 3:], axis=1, keepdims=True)
    return means, total[:, 3:] / np.where(lengths > 1e-12, lengths, 1.0), views[first]


def cell_numbers(points: Float[np.ndarray, "N 3"], side: float) -> Int[np.ndarray, "N"]:
    """Number the cubes of a grid that contain the points; equal numbers are equal cubes, and the order is that of x, y, z."""
    cells = np.floor(points / side).astype(np.int64)
    cells -= cells.min(0)
    sizes = cells.max(0).astype(object) + 1
    if sizes[0] * sizes[1] * sizes[2] > 2**62:
        # too many cubes for one number, as of points at very different distances
        return np.unique(cells, axis=0, return_inverse=True)[1].reshape(-1)
    return (cells[:, 0] * int(sizes[1]) + cells[:, 1]) * int(sizes[2]) + cells[:, 2]
