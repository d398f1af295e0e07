"""People in a cloud without a known pose: connected groups of points of a person's size."""

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.cluster.vq import kmeans2
from scipy.spatial import KDTree

from ...geometry.sampling import connected_labels
from ...observe.clouds import Cloud

#: neighbour whose distance measures the density at a point; a point is an outlier if it is farther than `SPARSE` times the
#: median
NEIGHBOUR, SPARSE = 4, 3.0
#: points nearer than this multiple of the median distance of that neighbour are connected, within these bounds, metres
LINK, MIN_LINK, MAX_LINK = 4.0, 0.05, 0.2
#: longest side of a person, as a share of the body's height at rest, and of any side of the box around it
MIN_SIZE, MAX_SIZE = 0.3, 1.4
#: least number of points, as a share of the largest group's
MIN_POINTS_SHARE = 0.1
#: points belong to a group at most so far away, metres
MAX_DISTANCE = 0.3
#: two people in one group: distance of their centres, metres; height of each, as a share of the group's; half the width of
#: the gap between them, as a share of that distance; and the largest share of the points in the gap
MIN_CENTRES_DISTANCE, MIN_HALF_HEIGHT, GAP, MAX_GAP_SHARE = 0.45, 0.7, 0.12, 0.07
#: quantiles of the points that bound an extent, robust to outliers
QUANTILES = (0.01, 0.99)


def find_groups(
    points: Float[np.ndarray, "N 3"], height: float, up: Float[np.ndarray, "3"], min_size: float = MIN_SIZE
) -> list[Int[np.ndarray, "_"]]:
    """Find groups of points that may each be a person; return the rows of each, largest group first.

    Sparse points are outliers. The others are grouped by their distances. A group that consists of two tall halves with
    few points between them is two people who touch. The points must not contain a floor, which would connect all groups.

    **Arguments:** `height` of a body at rest, metres; `up`, the vertical, of length one; `min_size`, the least longest side of
    a group, as a share of the height.
    """
    if len(points) <= NEIGHBOUR:
        return []
    far = KDTree(points).query(points, NEIGHBOUR + 1)[0][:, -1]
    usual = float(np.median(far))
    dense = np.flatnonzero(far <= SPARSE * max(usual, 1e-6))
    labels = connected_labels(points[dense], float(np.clip(LINK * usual, MIN_LINK, MAX_LINK)))
    groups = []
    for label in np.unique(labels):
        groups += _split(points, dense[labels == label], up)
    groups = [rows for rows in groups if _is_person_sized(points[rows], height, min_size)]
    most = max((len(rows) for rows in groups), default=0)
    return sorted((rows for rows in groups if len(rows) >= MIN_POINTS_SHARE * most), key=len, reverse=True)


def assign_to_groups(
    points: Float[np.ndarray, "N 3"], groups: list[Int[np.ndarray, "_"]]
) -> list[Bool[np.ndarray, "N"]]:
    """Assign all points to the nearest group, at most `MAX_DISTANCE` away; return the mask of each group.

    So the outliers of a person, and pieces of limbs behind others, belong to the person.
    """
    distances = np.stack([KDTree(points[rows]).query(points)[0] for rows in groups])
    nearest = np.argmin(distances, 0)
    near = np.min(distances, 0) <= MAX_DISTANCE
    return [near & (nearest == number) for number in range(len(groups))]


def real_points(cloud: Cloud) -> tuple[Float[np.ndarray, "N 3"], Int[np.ndarray, "N"]]:
    """Return the points of a cloud without its padding, and their rows."""
    rows = np.flatnonzero(np.asarray(cloud.weights) > 0)
    return np.asarray(cloud.points, float)[rows], rows


def _split(
    points: Float[np.ndarray, "N 3"], rows: Int[np.ndarray, "M"], up: Float[np.ndarray, "3"]
) -> list[Int[np.ndarray, "_"]]:
    """Split a group into the people that it consists of."""
    if len(rows) < 2 * (NEIGHBOUR + 1):
        return [rows]
    here = points[rows]
    flat = here - np.outer(here @ up, up)
    first = flat[np.argmax(np.linalg.norm(flat - np.median(flat, 0), axis=1))]
    second = flat[np.argmax(np.linalg.norm(flat - first, axis=1))]
    centres, labels = kmeans2(flat, np.stack([first, second]), minit="matrix")
    between = centres[1] - centres[0]
    distance = float(np.linalg.norm(between))
    if not distance >= MIN_CENTRES_DISTANCE:
        return [rows]
    along = (flat - centres.mean(0)) @ between / distance**2
    heights = [np.ptp(np.quantile(here[labels == k] @ up, QUANTILES)) for k in range(2)]
    tall = min(heights) >= MIN_HALF_HEIGHT * np.ptp(np.quantile(here @ up, QUANTILES))
    if not tall or np.mean(np.abs(along) < GAP) > MAX_GAP_SHARE:
        return [rows]
    return [part for k in range(2) for part in _split(points, rows[labels == k], up)]


def _is_person_sized(points: Float[np.ndarray, "N 3"], height: float, min_size: float) -> bool:
    low, high = np.quantile(points, QUANTILES, axis=0)
    return bool(min_size * height <= (high - low).max() <= MAX_SIZE * height)
