"""How good a result is: distances from scan to surface, and errors at the joints.

Plain NumPy in float64, apart from the fitting it judges.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import KDTree


class Summary(NamedTuple):
    """Location and spread of distances, in their unit (Adaptation, section 4.2.1)."""

    mean: float
    #: standard deviation of the population
    sd: float
    median: float
    #: median absolute deviation from the median, not scaled to a normal distribution
    mad: float
    #: distance between the quartiles
    iqr: float
    count: int


def distance_summary(distances: Float[np.ndarray, "N"]) -> Summary:
    """The `Summary` of distances; what is not finite is left out.

    **Raises:** `ValueError` where no finite distance is left.
    """
    finite = np.asarray(distances, float)[np.isfinite(distances)]
    if finite.size == 0:
        raise ValueError("There is no finite distance to summarise.")
    low, median, high = np.quantile(finite, [0.25, 0.5, 0.75])
    return Summary(
        mean=float(finite.mean()),
        sd=float(finite.std()),
        median=float(median),
        mad=float(np.median(np.abs(finite - median))),
        iqr=float(high - low),
        count=int(finite.size),
    )


def scan_to_surface(
    points: Float[np.ndarray, "N 3"], vertices: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"]
) -> Float[np.ndarray, "N"]:
    """The exact distance of each point to the nearest point of triangles with an area, metres.

    Triangles are sorted by size, since a triangle whose middle is farther than the best distance and
    its own radius together cannot be nearer: among triangles of one size few are left to try.
    """
    points = np.asarray(points, float)
    triangles = np.asarray(vertices, float)[np.asarray(faces)]
    middles = 0.5 * (triangles.min(1) + triangles.max(1))
    radii = np.linalg.norm(triangles - middles[:, None], axis=2).max(1)
    # sizes that differ by less than a factor of two go together; points have the least
    sizes = np.floor(np.log2(np.maximum(radii, 1e-6 * radii.max() + 1e-300))).astype(int)
    best = KDTree(triangles.reshape(-1, 3)).query(points)[0]
    for size in np.unique(sizes):
        alike = sizes == size
        best = _nearer(points, triangles[alike], middles[alike], radii[alike].max(), best)
    return best


def _nearer(
    points: Float[np.ndarray, "N 3"],
    triangles: Float[np.ndarray, "T 3 3"],
    middles: Float[np.ndarray, "T 3"],
    reach: float,
    best: Float[np.ndarray, "N"],
) -> Float[np.ndarray, "N"]:
    """The best distances after triangles of about one size, by the nearest middles first; the
    number tried doubles for the points that a farther one could still be nearer to."""
    from trimesh.triangles import closest_point

    tree, best = KDTree(middles), best.copy()
    left = np.flatnonzero(tree.query(points)[0] < best + reach)
    count = min(4, len(triangles))
    while left.size:
        # from the nearest on each time: middles as near as each other change ranks from query to query
        apart, near = tree.query(points[left], list(range(1, count + 1)))  # pyright: ignore[reportArgumentType]
        asked = np.repeat(points[left], count, axis=0)
        nearest = closest_point(triangles[near.reshape(-1)], asked)
        distances = np.linalg.norm(nearest - asked, axis=1).reshape(len(left), -1)
        best[left] = np.minimum(best[left], distances.min(1))
        if count == len(triangles):
            break
        left = left[apart[:, -1] < best[left] + reach]
        count = min(2 * count, len(triangles))
    return best


def joint_errors(
    joints: Float[np.ndarray, "F J 3"], truth: Float[np.ndarray, "F J 3"]
) -> Float[np.ndarray, "F J"]:
    """The distance between each joint centre and its true place, metres."""
    return np.linalg.norm(np.asarray(joints, float) - np.asarray(truth, float), axis=-1)
