"""How alike the ranges of two performers are (Limits, figure 7)."""

from typing import NamedTuple

import numpy as np
from scipy.spatial import KDTree

from ..arguments import checked
from .charts import chart_places, find_chart
from .samples import JointSamples


class Likeness(NamedTuple):
    """Distances from each sample of one to the closest of the other, both ways together; in the
    units of a quaternion's vector part, of which one is two radians."""

    mean: float
    deviation: float
    #: of the samples, how many were compared
    samples: int


@checked
def compare_samples(reference: JointSamples, other: JointSamples, every: int = 1) -> Likeness:
    """Mean and standard deviation of the distances between closest points of two clouds of rotations,
    in the chart of the reference; every so many samples.

    **Raises:** `ValueError` where the reference's rotations wrap.
    """
    chart = find_chart(reference)
    mine = chart_places(chart, reference.rotations[::every])
    others = chart_places(chart, other.rotations[::every])
    apart = np.concatenate([KDTree(mine).query(others)[0], KDTree(others).query(mine)[0]])
    return Likeness(float(apart.mean()), float(apart.std()), len(apart))
