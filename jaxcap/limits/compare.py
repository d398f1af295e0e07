"""Similarity of the ranges of two subjects (Limits, figure 7)."""

from typing import NamedTuple

import numpy as np
from scipy.spatial import KDTree

from ..arguments import checked
from .learning.fit_chart import chart_coordinates, find_chart
from .learning.samples import JointSamples


class SampleDistances(NamedTuple):
    """Distances between closest samples of two clouds, in both directions together.

    They are in units of a quaternion's vector part, where one is two radians.
    """

    mean: float
    deviation: float
    #: number of distances, one for each sample of both
    num_distances: int


@checked
def compare_samples(reference: JointSamples, other: JointSamples, every: int = 1) -> SampleDistances:
    """Compute mean and standard deviation of the distances between closest points of two rotation clouds.

    The distances are in the chart of the reference; every `every`-th sample is used.

    **Raises:** `ValueError` where the reference's rotations wrap.
    """
    chart = find_chart(reference)
    mine = chart_coordinates(chart, reference.rotations[::every])
    others = chart_coordinates(chart, other.rotations[::every])
    distances = np.concatenate([KDTree(mine).query(others)[0], KDTree(others).query(mine)[0]])
    return SampleDistances(float(distances.mean()), float(distances.std()), len(distances))
