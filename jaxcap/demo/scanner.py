"""Simulated depth cameras around a surface: noisy, partial clouds like real ones."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int


class Scanner(NamedTuple):
    """Depth cameras on a ring around the y axis, and their noise."""

    cameras: int = 6
    #: radius and height of the ring, metres
    distance: float = 2.5
    height: float = 0.5
    #: width of a pixel on the surface, metres: within it, nearer parts occlude farther ones
    pixel: float = 0.012
    #: points in a cloud
    points: int = 5000
    #: standard deviation along the line of sight, metres, and of normals, degrees
    noise: float = 0.004
    normal_noise: float = 10.0
    #: share of points that are uniform in the box around the body
    outliers: float = 0.03


def scan(
    scanner: Scanner,
    vertices: Float[np.ndarray, "V 3"],
    faces: Int[np.ndarray, "F 3"],
    rng: np.random.Generator,
) -> tuple[Float[np.ndarray, "N 3"], Float[np.ndarray, "N 3"]]:
    """Simulate the points and unit normals of one frame, in random order.

    The surface is sampled densely by area. A sample is visible to a camera if it faces the camera and no
    other sample in the same pixel is nearer by more than two pixel widths.
    """
    vertices, faces = np.asarray(vertices, float), np.asarray(faces)
    samples, normals = sample_surface(vertices, faces, 8 * scanner.points, rng)
    points, seen = [], []
    angles = 2 * np.pi * np.arange(scanner.cameras) / scanner.cameras
    for angle in angles:
        eye = np.array([scanner.distance * np.sin(angle), scanner.height, scanner.distance * np.cos(angle)])
        visible = _visible(samples, normals, eye, scanner)
        rays = samples[visible] - eye
        rays /= np.linalg.norm(rays, axis=1, keepdims=True)
        points.append(samples[visible] + scanner.noise * rng.normal(size=(len(visible), 1)) * rays)
        seen.append(normals[visible])
    points, seen = np.concatenate(points), np.concatenate(seen)
    wild = round(scanner.outliers * scanner.points)
    kept = rng.choice(len(points), min(scanner.points - wild, len(points)), replace=False)
    margin = 0.1
    anywhere = rng.uniform(vertices.min(0) - margin, vertices.max(0) + margin, (wild, 3))
    points = np.concatenate([points[kept], anywhere])
    tilt = np.radians(scanner.normal_noise) / np.sqrt(2) * rng.normal(size=(len(kept), 3))
    seen = np.concatenate([seen[kept] + tilt, rng.normal(size=(wild, 3))])
    seen /= np.linalg.norm(seen, axis=1, keepdims=True)
    order = rng.permutation(len(points))
    return points[order], seen[order]


def sample_surface(
    vertices: Float[np.ndarray, "V 3"],
    faces: Int[np.ndarray, "F 3"],
    count: int,
    rng: np.random.Generator,
) -> tuple[Float[np.ndarray, "N 3"], Float[np.ndarray, "N 3"]]:
    """Sample points on a surface uniformly by area, with the normals of their triangles."""
    corners = vertices[faces]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    areas = np.linalg.norm(across, axis=1)
    chosen = rng.choice(len(faces), count, p=areas / areas.sum())
    first, second = np.sqrt(rng.uniform(size=count)), rng.uniform(size=count)
    shares = np.stack([1 - first, first * (1 - second), first * second], 1)
    return np.einsum("nc,nca->na", shares, corners[chosen]), across[chosen] / areas[chosen, None]


def _visible(
    points: Float[np.ndarray, "N 3"],
    normals: Float[np.ndarray, "N 3"],
    eye: Float[np.ndarray, "3"],
    scanner: Scanner,
) -> Int[np.ndarray, "M"]:
    """Find the indices of the points visible to a camera at `eye` that looks at the y axis."""
    forward = -eye * [1.0, 0.0, 1.0] / scanner.distance
    right = np.cross(forward, [0.0, 1.0, 0.0])
    away = points - eye
    depth = away @ forward
    # focal length for pixels of width `pixel` at the axis
    focal = scanner.distance / scanner.pixel
    columns = np.floor(focal * (away @ right) / depth).astype(int)
    rows = np.floor(focal * away[:, 1] / depth).astype(int)
    columns, rows = columns - columns.min(), rows - rows.min()
    pixels = rows * (columns.max() + 1) + columns
    nearest = np.full(pixels.max() + 1, np.inf)
    np.minimum.at(nearest, pixels, depth)
    facing = np.sum(normals * away, 1) < -0.2 * np.linalg.norm(away, axis=1)
    return np.flatnonzero(facing & (depth < nearest[pixels] + 2 * scanner.pixel))
