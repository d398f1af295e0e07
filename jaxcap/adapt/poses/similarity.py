"""The similarity of scans, and detection of unordered scans."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Complex, Float
from scipy.spatial import KDTree

from ...geometry.sampling import even_indices
from ...observe.clouds import Cloud

#: sample points of a cloud's distance field: radii and heights about its middle, as shares of the body's
#: height, and the number of directions
RADII = (0.08, 0.18, 0.3, 0.45)
HEIGHTS = (-0.5, -0.38, -0.25, -0.12, 0.0, 0.12, 0.25, 0.38, 0.5)
DIRECTIONS = 24
#: distances are clipped at this, metres
MAX_DISTANCE = 0.3
#: number of compared pairs of successive scans, spread over all; as few scans as the second number are not
#: tested
MAX_PAIRS, MAX_UNTESTED_SCANS = 40, 5
#: scans are unordered if a successive pair is nearer than a random pair in less than this share of cases
MIN_NEARER_SHARE = 0.75
#: length of a step, RMS metres, that a tracker follows in any order
MAX_TRACKED_STEP = 0.02


class DistanceField(NamedTuple):
    """The distance field of a cloud about the vertical through its middle."""

    #: median of the points, metres
    middle: Float[np.ndarray, "3"]
    #: distance to the nearest point on rings about the middle, metres; y is up
    field: Float[np.ndarray, "R T"]

    @property
    def spectrum(self) -> Complex[np.ndarray, "R K"]:
        """The field's Fourier coefficients by direction."""
        return np.fft.rfft(self.field, axis=1)


def distance_field(cloud: Cloud, height: float) -> DistanceField:
    """Sample the distance field of a cloud on rings; `height` of the body scales them, metres."""
    points = np.asarray(cloud.points, float)[np.asarray(cloud.weights) > 0]
    middle = np.median(points, axis=0)
    angles = 2 * np.pi * np.arange(DIRECTIONS) / DIRECTIONS
    radii, heights = (part.reshape(-1, 1) for part in np.meshgrid(RADII, HEIGHTS))
    # a rotation about y takes the direction (0, 0, 1) to (sin, 0, cos)
    rings = np.stack([radii * np.sin(angles), heights + 0 * angles, radii * np.cos(angles)], -1) * height
    field = KDTree(points).query((middle + rings).reshape(-1, 3), distance_upper_bound=MAX_DISTANCE)[0]
    return DistanceField(middle, np.minimum(field, MAX_DISTANCE).reshape(len(radii), DIRECTIONS))


def rotated_distances(one: DistanceField, other: DistanceField) -> Float[np.ndarray, "T"]:
    """Compute the RMS difference of two fields, metres, for rotations `2 pi k / T` of `one` about y."""
    # circular correlation over all rotations
    both = np.fft.irfft(np.sum(np.conj(one.spectrum) * other.spectrum, 0), n=DIRECTIONS)
    squares = np.sum(one.field**2) + np.sum(other.field**2) - 2 * both
    return np.sqrt(np.maximum(squares, 0.0) / one.field.size)


def scan_distance(one: DistanceField, other: DistanceField) -> float:
    """Compute the distance between two scans, metres, from the body's position and its distance field."""
    field = np.sqrt(np.mean((one.field - other.field) ** 2))
    return float(np.hypot(field, np.linalg.norm(one.middle - other.middle)))


def is_unordered(cloud: Callable[[int], Cloud], frames: Sequence[int], height: float) -> bool:
    """Test if scans are unordered in time: successive scans are hardly more similar than random pairs.

    At most 80 scans are read. Too few scans, and scans with little motion, count as ordered.

    **Arguments:** `cloud(frame)` returns the scan of each of the `frames`; `height` of the body, metres.
    """
    if len(frames) <= MAX_UNTESTED_SCANS:
        return False
    first = even_indices(len(frames) - 1, MAX_PAIRS)
    rows = np.union1d(first, first + 1)
    shapes = {row: distance_field(cloud(frames[row]), height) for row in rows.tolist()}
    steps = np.array([scan_distance(shapes[row], shapes[row + 1]) for row in first.tolist()])
    distances = [
        scan_distance(shapes[one], shapes[other])
        for one in rows.tolist()
        for other in rows.tolist()
        if other > one + 1
    ]
    return bool(
        np.median(steps) > MAX_TRACKED_STEP and share_nearer(steps, np.array(distances)) < MIN_NEARER_SHARE
    )


def share_nearer(steps: Float[np.ndarray, "S"], random_distances: Float[np.ndarray, "P"]) -> float:
    """Estimate the probability that a step is shorter than a random pair's distance; 0.5 without order."""
    ranks = np.searchsorted(np.sort(random_distances), steps) / len(random_distances)
    return float(1.0 - ranks.mean())
