"""Floors and walls in points of a room."""

from collections.abc import Iterable, Iterator
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from ..arguments import checked
from ..geometry.mesh import area_normals
from ..geometry.normals import estimate_normals

#: distance of points that belong to a plane, and share of all points that makes a plane floor or wall
PLANE_DISTANCE, MIN_PLANE_SHARE = 0.03, 0.12
#: the same for a cloud: fewer points do not mislead a fit
MIN_ROOM_SHARE = 0.1
#: number of planes that are looked for, and of tried triples of points for each
NUM_PLANES, NUM_TRIALS = 4, 200
#: the same where normals are known, and the least cosine between them and the normal of the plane
NUM_CHECKED_TRIALS, MIN_CORNER_COSINE = 2000, 0.8
#: least width of a plane in an image, or its least length if it is narrower, and least width in a cloud, metres
MIN_WIDTH, MIN_LENGTH, MIN_CLOUD_WIDTH = 0.8, 1.5, 1.2
#: largest share of points behind a wall, or below a floor
MAX_BEHIND = 0.05
#: share of the points on a plane that have its normal, and the largest angle between the two, degrees
MIN_ALIGNED_SHARE, MAX_NORMAL_ANGLE = 0.5, 30.0
#: least share of the rectangle around a floor or wall that its points fill
MIN_FILLED_SHARE = 0.6


class Plane(NamedTuple):
    """The points `x` with `normal @ x == offset`."""

    #: unit, towards the camera
    normal: Float[np.ndarray, "3"]
    #: metres
    offset: float


@checked
def find_planes(
    points: Float[np.ndarray, "N 3"],
    eye: Float[np.ndarray, "3"] | None = None,
    *,
    normals: Float[np.ndarray, "N 3"] | None = None,
    min_share: float = MIN_PLANE_SHARE,
) -> list[Plane]:
    """Find floors and walls by random sample consensus: wide planes with many points and few points behind them.

    **Arguments:** `eye`, the position of the camera, metres; without it the side with more points is the front.
    `normals` of the points, if they are known, and zero where one is not: most points of a floor or wall have
    its normal, and those of a person do not. `min_share`, the least share of all points on a plane.
    """
    candidates = []
    for plane in _densest_planes(points, normals, min_share):
        on = on_planes([plane], points)
        flat = normals is None or (
            np.sum(is_aligned(normals[on], plane))
            > MIN_ALIGNED_SHARE * np.sum(np.any(normals[on] != 0, axis=1))
            and filled_share(points[on], plane.normal) > MIN_FILLED_SHARE
        )
        if flat and _is_wide(points[on], of_cloud=normals is not None):
            candidates.append(_towards(plane, points, eye))
    return [plane for plane in candidates if _is_last(plane, points, [] if normals is None else candidates)]


def _densest_planes(
    points: Float[np.ndarray, "N 3"], normals: Float[np.ndarray, "N 3"] | None, min_share: float
) -> Iterator[Plane]:
    """Yield the planes with the most points, each among the points that are not on the planes before."""
    rng, left = np.random.default_rng(0), np.arange(len(points))
    for _ in range(NUM_PLANES):
        if len(left) < 100:
            return
        triples = left[
            rng.integers(len(left), size=(NUM_TRIALS if normals is None else NUM_CHECKED_TRIALS, 3))
        ]
        across = area_normals(points[triples])
        lengths = np.linalg.norm(across, axis=1)
        good = lengths > 1e-6
        across, triples = across[good] / lengths[good, None], triples[good]
        if normals is not None:
            # three points of one plane have its normal
            likely = (np.abs(np.einsum("tka,ta->tk", normals[triples], across)) > MIN_CORNER_COSINE).all(1)
            across, triples = across[likely], triples[likely]
        if not len(triples):
            return
        offsets = np.sum(across * points[triples[:, 0]], 1)
        few = points[left[:: max(1, len(left) // 2000)]]
        shares = np.mean(np.abs(few @ across.T - offsets) < PLANE_DISTANCE, 0)
        best = int(np.argmax(shares))
        if shares[best] * len(left) < min_share * len(points):
            return
        plane = Plane(across[best], float(offsets[best]))
        yield plane
        left = left[~on_planes([plane], points[left])]


def _is_last(plane: Plane, points: Float[np.ndarray, "N 3"], others: list[Plane]) -> bool:
    """Test that few points are behind a plane, as behind a wall or below a floor; much is behind a plane through a
    person. Points on other planes do not count: a floor may go on behind a wall."""
    behind = points @ plane.normal - plane.offset < -2 * PLANE_DISTANCE
    return (
        float(np.mean(behind & ~on_planes([one for one in others if one is not plane], points))) < MAX_BEHIND
    )


def _towards(plane: Plane, points: Float[np.ndarray, "N 3"], eye: Float[np.ndarray, "3"] | None) -> Plane:
    """Choose the sign of a plane: its normal points to the camera, or to the side with more points."""
    heights = (points if eye is None else eye[None]) @ plane.normal - plane.offset
    front = np.sum(heights > 2 * PLANE_DISTANCE) >= np.sum(heights < -2 * PLANE_DISTANCE)
    if eye is not None:
        front = heights[0] > 0
    return plane if front else Plane(-plane.normal, -plane.offset)


def is_aligned(normals: Float[np.ndarray, "N 3"], plane: Plane) -> Bool[np.ndarray, "N"]:
    """Test which normals are those of a plane, with either sign."""
    return np.abs(normals @ plane.normal) > np.cos(np.radians(MAX_NORMAL_ANGLE))


def on_planes(planes: list[Plane], points: Float[np.ndarray, "*points 3"]) -> Bool[np.ndarray, "*points"]:
    """Test which points are on any of the planes, within `PLANE_DISTANCE`."""
    on = np.zeros(points.shape[:-1], bool)
    for plane in planes:
        on |= np.abs(points @ plane.normal - plane.offset) < PLANE_DISTANCE
    return on


@checked
def refine_plane(plane: Plane, points: Float[np.ndarray, "N 3"]) -> Plane:
    """Fit a plane to the points on it by least squares of their distances."""
    near = points[on_planes([plane], points)]
    if len(near) < 3:
        return plane
    middle = near.mean(0)
    normal = np.linalg.svd(near - middle, full_matrices=False)[2][2]
    normal = normal * np.sign(normal @ plane.normal)
    return Plane(normal, float(normal @ middle))


def filled_share(points: Float[np.ndarray, "N 3"], normal: Float[np.ndarray, "3"]) -> float:
    """Compute the share of a rectangle around points on a plane that they fill, in cells that should have five points.

    A floor fills most of it, and a person with raised arms does not.
    """
    across = np.linalg.svd(normal[None])[2][1:]
    flat = (points - points.mean(0)) @ across.T
    # along the longest direction of the points
    flat = flat @ np.linalg.svd(flat - flat.mean(0), full_matrices=False)[2].T
    low, high = np.quantile(flat, [0.02, 0.98], axis=0)
    flat = flat[((flat >= low) & (flat <= high)).all(1)]
    counts = np.maximum(((high - low) / np.sqrt(5 * np.prod(high - low) / max(len(flat), 1))).astype(int), 1)
    cells = np.minimum(((flat - low) / (high - low) * counts).astype(int), counts - 1)
    return len(np.unique(cells, axis=0)) / float(np.prod(counts))


def _is_wide(points: Float[np.ndarray, "N 3"], of_cloud: bool) -> bool:
    """Test if points extend farther than a person's back; in a cloud, which may show a person from all sides, in two
    directions."""
    low, high = np.quantile(points, [0.05, 0.95], axis=0)
    _, width, length = np.sort(high - low)
    return bool(width > MIN_CLOUD_WIDTH if of_cloud else width > MIN_WIDTH or length > MIN_LENGTH)


def in_room(
    points: Float[np.ndarray, "N 3"], normals: Float[np.ndarray, "N 3"], planes: Iterable[Plane]
) -> Bool[np.ndarray, "N"]:
    """Test which points are on a plane, or behind it.

    Points within three standard deviations of its own points are on it, and farther ones, up to `PLANE_DISTANCE`, if they
    have its normal or none: others may be of a foot.
    """
    found = np.zeros(len(points), bool)
    for plane in planes:
        heights = points @ plane.normal - plane.offset
        flat = is_aligned(normals, plane) | ~np.any(normals != 0, axis=1)
        near = np.abs(heights) < PLANE_DISTANCE
        deviation = 1.4826 * np.median(np.abs(heights[near])) if near.any() else 0.0
        found |= (heights < -PLANE_DISTANCE) | (near & (flat | (np.abs(heights) < 3 * deviation)))
    return found


def estimate_cloud_normals(points: Float[np.ndarray, "N 3"]) -> Float[np.ndarray, "N 3"]:
    """Estimate the normals of a cloud by `estimate_normals`, separately for the points on floors and walls.

    Signs are propagated from point to point, and would spread from a floor to the feet on it.
    """
    normals = estimate_normals(points)
    planes = find_planes(points, normals=normals, min_share=MIN_ROOM_SHARE)
    others = ~in_room(points, normals, planes)
    if planes and others.any():
        normals[others] = estimate_normals(points[others])
    return normals
