"""Simulated scans of single frames of a moving surface, reproducible for each frame."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float, Int

from ..arguments import check_metres, checked
from ..errors import InputError
from ..geometry.camera import Camera
from ..value_checks import check_faces
from .depth import make_ray_mesh, render_depth
from .fuse import FusedScan, fuse_cloud, fuse_mesh
from .noise import apply_errors
from .settings import Scanner, check_scanner

#: margin of the box of outliers around the surface, metres
OUTLIER_MARGIN = 0.1


@checked
def scan_frame(
    scanner: Scanner,
    cameras: Sequence[Camera],
    vertices: Float[np.ndarray, "V 3"],
    faces: Int[np.ndarray, "F 3"],
    seed: int = 0,
    frame: int = 0,
) -> FusedScan:
    """Simulate the scan of one frame by all cameras, metres: a cloud, or a mesh if `scanner.mesh`.

    Random numbers depend on `seed`, `frame` and the view only, not on earlier scans. A scan is empty if no
    view measures anything.

    **Raises:** `InputError` for a setting out of its range, no cameras, a seed or frame below zero, vertices
    that cannot be in metres, and triangles of missing vertices.
    """
    check_metres("scan_frame", "vertices", vertices)
    check_faces("scan_frame", faces, len(vertices))
    depths = scan_depths(scanner, cameras, vertices, faces, seed, frame)
    if scanner.mesh:
        return fuse_mesh(cameras, depths, scanner.gap, scanner.normal_window)
    scan = fuse_cloud(cameras, depths, scanner.gap, scanner.normal_window, scanner.voxel)
    rng = _random(seed, frame, 1)
    if scanner.points is not None and scanner.points < len(scan.points):
        kept = np.sort(rng.choice(len(scan.points), scanner.points, replace=False))
        scan = FusedScan(scan.points[kept], scan.normals[kept], scan.views[kept], scan.faces)
    return add_outliers(scan, scanner.outliers, vertices, rng)


def add_outliers(
    scan: FusedScan, share: float, vertices: Float[np.ndarray, "V 3"], rng: np.random.Generator
) -> FusedScan:
    """Replace a random share of a cloud by points uniform in the box of the surface and 0.1 m around it.

    Their normals are random; their views are those of the points that they replace.
    """
    count = round(share * len(scan.points))
    if count == 0:
        return scan
    chosen = rng.choice(len(scan.points), count, replace=False)
    points, normals = scan.points.copy(), scan.normals.copy()
    points[chosen] = rng.uniform(
        vertices.min(0) - OUTLIER_MARGIN, vertices.max(0) + OUTLIER_MARGIN, (count, 3)
    )
    directions = rng.normal(size=(count, 3))
    normals[chosen] = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    return FusedScan(points, normals, scan.views, scan.faces)


def scan_depths(
    scanner: Scanner,
    cameras: Sequence[Camera],
    vertices: Float[np.ndarray, "V 3"],
    faces: Int[np.ndarray, "F 3"],
    seed: int = 0,
    frame: int = 0,
) -> list[Float[np.ndarray, "H W"]]:
    """Simulate each camera's depth image of one frame, metres, zero for pixels without measurement.

    Arguments and errors are those of `scan_frame`.
    """
    check_scanner(scanner)
    if not cameras:
        raise InputError("There are no cameras to scan with; give at least one.")
    if seed < 0 or frame < 0:
        raise InputError(f"The seed is {seed} and the frame is {frame}; expected both at least 0.")
    surface, depths = make_ray_mesh(vertices, faces), []
    for view, (camera, lost) in enumerate(
        zip(cameras, sample_dropped_views(scanner.drop, len(cameras), seed, frame), strict=True)
    ):
        if lost:
            depths.append(np.zeros((camera.height, camera.width)))
        else:
            depths.append(
                apply_errors(scanner, render_depth(camera, surface), _random(seed, frame, 2 + view))
            )
    return depths


def sample_dropped_views(share: float, count: int, seed: int, frame: int) -> Bool[np.ndarray, "C"]:
    """Sample the lost ones of `count` views in a frame, each with probability `share`, but never all."""
    chance = _random(seed, frame, 0).random(count)
    lost = chance < share
    lost[np.argmax(chance)] = False
    return lost


def _random(seed: int, frame: int, stream: int) -> np.random.Generator:
    """Make the random generator of one frame and one purpose (`stream`)."""
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(frame, stream)))
