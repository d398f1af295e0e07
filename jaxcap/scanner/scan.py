"""Simulated scans of single frames of a moving surface, reproducible for each frame."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from ..arguments import checked
from ..depth.fuse import FusedScan, fuse_cloud, fuse_mesh
from ..errors import InputError
from ..geometry.camera import Camera, check_no_lenses
from ..value_checks import check_faces, check_metres
from .noise import apply_errors
from .ray_casting import make_ray_mesh, render_depth
from .rooms import Room
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
    room: Room | None = None,
) -> FusedScan:
    """Simulate the scan of one frame by all cameras, metres: a cloud, or a mesh if `scanner.mesh`.

    The scan contains the `room` too, where one is given.

    Random numbers depend on `seed`, `frame` and the view only, not on earlier scans. A scan is empty if no
    view measures anything.

    **Raises:** `InputError` for a setting out of its range, no cameras, a camera with a lens, a seed or frame below zero, vertices
    that cannot be in metres, and triangles of missing vertices.
    """
    check_metres("scan_frame", "vertices", vertices)
    check_faces("scan_frame", faces, len(vertices))
    surfaces = [(vertices, faces), *([] if room is None else [room])]
    depths = [image.depth for image in scan_scene(scanner, cameras, surfaces, seed, frame)]
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


class LabelledDepth(NamedTuple):
    """A depth image, and the surface that each pixel shows."""

    #: metres along the optical axis; zero for pixels without measurement
    depth: Float[np.ndarray, "H W"]
    #: number of the surface, by its position in the scene; -1 for pixels without measurement
    labels: Int[np.ndarray, "H W"]


@checked
def scan_scene(
    scanner: Scanner,
    cameras: Sequence[Camera],
    surfaces: Sequence[tuple[Float[np.ndarray, "_ 3"], Int[np.ndarray, "_ 3"]]],
    seed: int = 0,
    frame: int = 0,
) -> list[LabelledDepth]:
    """Simulate each camera's depth image of several surfaces, such as people and a room.

    **Arguments:** `surfaces`, vertices in metres and triangles of each. The others are those of `scan_frame`.

    **Raises:** the errors of `scan_frame`.
    """
    check_scanner(scanner)
    if not cameras:
        raise InputError("There are no cameras to scan with; give at least one.")
    check_no_lenses(cameras)
    if seed < 0 or frame < 0:
        raise InputError(f"The seed is {seed} and the frame is {frame}; expected both at least 0.")
    for vertices, faces in surfaces:
        check_metres("scan_scene", "vertices", vertices)
        check_faces("scan_scene", faces, len(vertices))
    first = np.cumsum([0, *(len(vertices) for vertices, _ in surfaces)])
    faces = np.concatenate([faces + start for (_, faces), start in zip(surfaces, first, strict=False)])
    owners = np.repeat(np.arange(len(surfaces)), [len(faces) for _, faces in surfaces])
    scene = make_ray_mesh(np.concatenate([vertices for vertices, _ in surfaces]), faces)
    dropped = sample_dropped_views(scanner.drop, len(cameras), seed, frame)
    images = []
    for view, (camera, lost) in enumerate(zip(cameras, dropped, strict=True)):
        if lost:
            shape = camera.height, camera.width
            images.append(LabelledDepth(np.zeros(shape), np.full(shape, -1)))
            continue
        image = render_depth(camera, scene)
        depth = apply_errors(scanner, image, float(camera.focal[0]), _random(seed, frame, 2 + view))
        images.append(LabelledDepth(depth, np.where(depth > 0, owners[image.triangles], -1)))
    return images


def sample_dropped_views(share: float, count: int, seed: int, frame: int) -> Bool[np.ndarray, "C"]:
    """Sample the lost ones of `count` views in a frame, each with probability `share`, but never all."""
    chance = _random(seed, frame, 0).random(count)
    lost = chance < share
    lost[np.argmax(chance)] = False
    return lost


def _random(seed: int, frame: int, stream: int) -> np.random.Generator:
    """Make the random generator of one frame and one purpose (`stream`)."""
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(frame, stream)))
