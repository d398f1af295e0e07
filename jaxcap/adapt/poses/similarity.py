"""How alike scans are, and whether they follow each other in time."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Complex, Float
from scipy.spatial import KDTree

from ...observe import Cloud

#: radii and heights about the middle of a cloud, in its height, and directions, at which its distance field is sampled
RADII = (0.08, 0.18, 0.3, 0.45)
HEIGHTS = (-0.5, -0.38, -0.25, -0.12, 0.0, 0.12, 0.25, 0.38, 0.5)
DIRECTIONS = 24
#: distances beyond this, metres, say nothing more
FAR = 0.3
#: pairs of successive scans that are compared, spread over all; fewer than the second number show nothing
PAIRS, LEAST = 40, 5
#: scans are unordered where a successive pair is nearer to each other than a random pair in less than this share of cases
NEARER = 0.75
#: root mean square metres of a step that a tracker follows in any order
STILL = 0.02


class Shape(NamedTuple):
    """The distance field of a cloud about the vertical through its middle."""

    #: median of the points, metres
    middle: Float[np.ndarray, "3"]
    #: distance to the nearest point at rings about the middle, metres; y is up
    field: Float[np.ndarray, "R T"]

    @property
    def spectrum(self) -> Complex[np.ndarray, "R K"]:
        """The field's Fourier coefficients by direction."""
        return np.fft.rfft(self.field, axis=1)


def shape_of(cloud: Cloud, height: float) -> Shape:
    """Sample the distance field of a cloud on rings; `height` of the body scales them, metres."""
    points = np.asarray(cloud.points, float)[np.asarray(cloud.weights) > 0]
    middle = np.median(points, axis=0)
    angles = 2 * np.pi * np.arange(DIRECTIONS) / DIRECTIONS
    radii, heights = (part.reshape(-1, 1) for part in np.meshgrid(RADII, HEIGHTS))
    # a turn about y by an angle carries the direction (0, 0, 1) to (sin, 0, cos)
    rings = np.stack([radii * np.sin(angles), heights + 0 * angles, radii * np.cos(angles)], -1) * height
    field = KDTree(points).query((middle + rings).reshape(-1, 3), distance_upper_bound=FAR)[0]
    return Shape(middle, np.minimum(field, FAR).reshape(len(radii), DIRECTIONS))


def turned_distances(one: Shape, other: Shape) -> Float[np.ndarray, "T"]:
    """Root mean square difference of two fields, metres, when `one` is turned about its vertical to each direction:
    by `2 pi k / T`."""
    # the correlation over all turns at once
    both = np.fft.irfft(np.sum(np.conj(one.spectrum) * other.spectrum, 0), n=DIRECTIONS)
    squares = np.sum(one.field**2) + np.sum(other.field**2) - 2 * both
    return np.sqrt(np.maximum(squares, 0.0) / one.field.size)


def step_between(one: Shape, other: Shape) -> float:
    """How far it is from one scan to another, metres: the body's place and its distance field."""
    field = np.sqrt(np.mean((one.field - other.field) ** 2))
    return float(np.hypot(field, np.linalg.norm(one.middle - other.middle)))


def is_unordered(cloud: Callable[[int], Cloud], frames: Sequence[int], height: float) -> bool:
    """Whether scans do not follow each other in time: successive ones are no nearer to each other than any two are.

    **Arguments:** `cloud(frame)` gives the scan of each of the `frames`; `height` of the body, metres. At most 80 scans
    are read. Too few of them, and those in which hardly anything moves, count as ordered.
    """
    if len(frames) <= LEAST:
        return False
    first = np.unique(np.linspace(0, len(frames) - 2, min(PAIRS, len(frames) - 1)).astype(int))
    rows = np.union1d(first, first + 1)
    shapes = {row: shape_of(cloud(frames[row]), height) for row in rows.tolist()}
    steps = np.array([step_between(shapes[row], shapes[row + 1]) for row in first.tolist()])
    apart = [
        step_between(shapes[one], shapes[other])
        for one in rows.tolist()
        for other in rows.tolist()
        if other > one + 1
    ]
    return bool(np.median(steps) > STILL and share_nearer(steps, np.array(apart)) < NEARER)


def share_nearer(steps: Float[np.ndarray, "S"], apart: Float[np.ndarray, "P"]) -> float:
    """The chance that a step is shorter than the distance of a random pair: a half where the order says nothing."""
    ranks = np.searchsorted(np.sort(apart), steps) / len(apart)
    return float(1.0 - ranks.mean())
