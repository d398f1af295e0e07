"""Exact nearest points on a triangle mesh. Plain NumPy in float64."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import KDTree

#: number of triangles of a size that are tested first
FIRST = 8


class SurfacePoints(NamedTuple):
    """Points on triangles: `sum_k barycentric_k vertices[faces[triangles, k]]`."""

    triangles: Int[np.ndarray, "N"]
    #: barycentric coordinates, at least zero, with sum one
    barycentric: Float[np.ndarray, "N 3"]
    #: distances to the query points, in their unit; infinite where nothing is within reach
    distances: Float[np.ndarray, "N"]


def nearest_on_surface(
    points: Float[np.ndarray, "N 3"],
    vertices: Float[np.ndarray, "V 3"],
    faces: Int[np.ndarray, "F 3"],
    max_distance: float = np.inf,
) -> SurfacePoints:
    """Find the nearest point of a surface to each point, exactly, for any sizes and shapes of triangles.

    A triangle cannot be nearer if the distance to its centre exceeds the best distance plus its own radius.
    Triangles are grouped by size, so that few of each group remain to be tested. Beyond `max_distance` nothing is
    searched: the distance is infinite there, and triangle and coordinates have no meaning.
    """
    points, faces = np.asarray(points, float), np.asarray(faces)
    corners = np.asarray(vertices, float)[faces]
    middles = 0.5 * (corners.min(1) + corners.max(1))
    radii = np.sqrt(np.sum((corners - middles[:, None]) ** 2, 2).max(1))
    # one group for each factor of two in size; degenerate triangles are in the smallest
    sizes = np.floor(np.log2(np.maximum(radii, 1e-6 * radii.max(initial=0.0) + 1e-300))).astype(int)
    best = _nearest_corners(points, vertices, faces, max_distance)
    for size in np.unique(sizes):
        alike = np.flatnonzero(sizes == size)
        _update_nearest(best, points, corners, alike, middles[alike], radii[alike])
    return best._replace(distances=np.where(best.distances <= max_distance, best.distances, np.inf))


def positions_on_surface(
    points: SurfacePoints, vertices: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"]
) -> Float[np.ndarray, "N 3"]:
    """Compute the positions of points on a surface, metres."""
    return np.einsum("nk,nka->na", points.barycentric, vertices[faces[points.triangles]])


def closest_barycentric(
    triangles: Float[np.ndarray, "N 3 3"], points: Float[np.ndarray, "N 3"]
) -> tuple[Float[np.ndarray, "N 3"], Float[np.ndarray, "N"]]:
    """Compute the nearest point of each triangle to a point, as barycentric coordinates, and its squared
    distance.

    It lies on one of the three sides, or at the projection of the point onto the plane. Degenerate
    triangles have only their sides.
    """
    a, b, c = (np.ascontiguousarray(triangles[:, k].T) for k in range(3))
    p = np.ascontiguousarray(points.T)
    shares, squared = np.zeros((3, len(points))), np.full(len(points), np.inf)
    ab, ac, ap = b - a, c - a, p - a
    # the interior
    bb, bc, cc, pb, pc = _dot(ab, ab), _dot(ab, ac), _dot(ac, ac), _dot(ap, ab), _dot(ap, ac)
    area = bb * cc - bc * bc
    safe = np.where(area > 0, area, 1.0)
    second, third = (cc * pb - bc * pc) / safe, (bb * pc - bc * pb) / safe
    first = 1.0 - second - third
    inside = (area > 0) & (first >= 0) & (second >= 0) & (third >= 0)
    differences = ap - second * ab - third * ac
    squared = np.where(inside, _dot(differences, differences), np.inf)
    shares = np.where(inside, np.stack([first, second, third]), 0.0)
    # the sides
    for start, end, side, length, along in (
        (0, 1, ab, bb, pb),
        (0, 2, ac, cc, pc),
        (1, 2, c - b, None, None),
    ):
        from_start = ap if start == 0 else p - b
        length = _dot(side, side) if length is None else length
        along = _dot(from_start, side) if along is None else along
        share = np.clip(along / np.where(length > 0, length, 1.0), 0.0, 1.0)
        differences = from_start - share * side
        here = _dot(differences, differences)
        nearer = np.flatnonzero(here < squared)
        squared[nearer] = here[nearer]
        shares[:, nearer] = 0.0
        shares[start, nearer], shares[end, nearer] = 1.0 - share[nearer], share[nearer]
    return np.ascontiguousarray(shares.T), squared


def _dot(a: Float[np.ndarray, "3 N"], b: Float[np.ndarray, "3 N"]) -> Float[np.ndarray, "N"]:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _nearest_corners(points, vertices, faces, max_distance: float) -> SurfacePoints:
    """Find the nearest corner of all triangles; the first triangle of each corner represents it."""
    used, first = np.unique(faces, return_index=True)
    distances, nearest = KDTree(np.asarray(vertices, float)[used]).query(points, workers=-1)
    triangles, corner = np.divmod(first[nearest], 3)
    # distances beyond reach are clamped to it
    return SurfacePoints(
        triangles, np.eye(3)[corner], np.minimum(distances, np.nextafter(max_distance, np.inf))
    )


def _update_nearest(best: SurfacePoints, points, corners, group, centres, radii) -> None:
    """Update `best` in place with nearer points on triangles of similar size, in order of distance to their
    centres.

    The number of tested triangles doubles for points that a farther one could still be nearer to.
    """
    tree, largest = KDTree(centres), radii.max()
    left, tried = np.arange(len(points)), np.zeros(len(points))
    count = min(FIRST, len(group))
    while left.size:
        # always from the first neighbour: ranks of equidistant centres change between queries
        distances, near = tree.query(
            points[left],
            list(range(1, count + 1)),  # pyright: ignore[reportArgumentType]
            distance_upper_bound=np.nextafter(np.max(best.distances[left]) + largest, np.inf),
            workers=-1,
        )
        # a missing neighbour has an infinite distance and an index out of range
        near = np.minimum(near, len(group) - 1)
        reach = best.distances[left, None] + radii[near]
        row, column = np.nonzero((distances < reach) & (distances >= tried[left, None]))
        which, triangle = left[row], group[near[row, column]]
        shares, squared = closest_barycentric(corners[triangle], points[which])
        # the last triangle written for each point is its nearest
        order = np.flatnonzero(np.sqrt(squared) < best.distances[which])
        order = order[np.argsort(-squared[order], kind="stable")]
        best.triangles[which[order]] = triangle[order]
        best.barycentric[which[order]] = shares[order]
        best.distances[which[order]] = np.sqrt(squared[order])
        if count == len(group):
            break
        tried[left] = distances[:, -1]
        left = left[distances[:, -1] < best.distances[left] + largest]
        count = min(2 * count, len(group))
