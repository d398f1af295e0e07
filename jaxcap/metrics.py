"""Metrics of a result: distances from scan to surface, and joint errors.

Plain NumPy in float64, independent of the fitting code.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from .geometry.closest import nearest_on_surface


class Summary(NamedTuple):
    """Location and spread of distances, in their unit (Adaptation, section 4.2.1)."""

    mean: float
    #: standard deviation of the population
    sd: float
    median: float
    #: median absolute deviation from the median, not scaled to a normal distribution
    mad: float
    #: interquartile range
    iqr: float
    count: int


def distance_summary(distances: Float[np.ndarray, "N"]) -> Summary:
    """Compute the `Summary` of distances; values that are not finite are excluded.

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
    """Compute the exact distance of each point to the nearest point of the triangles, metres."""
    return nearest_on_surface(points, vertices, faces).distances


def joint_errors(
    joints: Float[np.ndarray, "F J 3"], truth: Float[np.ndarray, "F J 3"]
) -> Float[np.ndarray, "F J"]:
    """Compute the distance between each joint centre and its true position, metres."""
    return np.linalg.norm(np.asarray(joints, float) - np.asarray(truth, float), axis=-1)
