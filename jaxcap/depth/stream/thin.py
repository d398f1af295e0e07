"""Thinning of a cloud by the curvature of its surface: flat surface keeps few points, curved surface such as a forearm keeps many."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from ...geometry.sampling import even_indices
from ..fuse import cell_numbers

#: largest side of the cubes in which points are merged, in sides of the finest ones
MAX_LEVEL = 3


class ThinnedPoints(NamedTuple):
    """Points that represent others."""

    points: Float[np.ndarray, "N 3"]
    #: unit, or zero where unknown
    normals: Float[np.ndarray, "N 3"]
    #: number of points that each represents
    weights: Float[np.ndarray, "N"]


def thin_points(
    points: Float[np.ndarray, "N 3"], normals: Float[np.ndarray, "N 3"], side: float, count: int
) -> ThinnedPoints:
    """Merge points in cubes until at most `count` are left, where their normals are most alike first.

    The cubes have twice the `side`, metres, at first, and twice that in further rounds. A merged point has the mean position, the mean
    normal and the number of its points as weight. So all weights have the same sum as before, and the flat parts of the surface,
    where points are redundant, lose most. The result does not depend on the order of the points.
    """
    found = ThinnedPoints(points, normals, np.ones(len(points)))
    level = 1
    while len(found.points) > count and level <= MAX_LEVEL:
        found = _merge(found, side * 2**level, count)
        level += 1
    if len(found.points) > count:
        # even a cube of eight sides is not enough; equal steps keep the density
        rows = even_indices(len(found.points), count, nearest=True)
        scale = found.weights.sum() / found.weights[rows].sum()
        found = ThinnedPoints(found.points[rows], found.normals[rows], scale * found.weights[rows])
    return found


def _merge(found: ThinnedPoints, side: float, count: int) -> ThinnedPoints:
    """Merge the points of as many cubes as needed, those with the most similar normals first."""
    weights = found.weights
    _, cell = np.unique(cell_numbers(found.points, side), return_inverse=True)
    num = int(cell.max()) + 1
    sums = np.stack(
        [np.bincount(cell, weights * column, num) for column in (*found.points.T, *found.normals.T)], 1
    )
    members, total = np.bincount(cell, minlength=num), np.bincount(cell, weights, num)
    lengths = np.linalg.norm(sums[:, 3:], axis=1)
    # the information on directions that is lost, for each point that is saved
    saved = members - 1
    loss = np.where(saved > 0, (total - lengths) / np.maximum(saved, 1), np.inf)
    order = np.argsort(loss, kind="stable")
    enough = np.searchsorted(np.cumsum(saved[order]), len(weights) - count) + 1
    merged = np.zeros(num, bool)
    merged[order[:enough]] = True
    merged &= saved > 0
    kept = ~merged[cell]
    unit = sums[merged, 3:] / np.maximum(lengths[merged], 1e-12)[:, None]
    return ThinnedPoints(
        np.concatenate([found.points[kept], sums[merged, :3] / total[merged, None]]),
        np.concatenate([found.normals[kept], unit]),
        np.concatenate([weights[kept], total[merged]]),
    )
