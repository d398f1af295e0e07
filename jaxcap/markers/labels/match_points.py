"""Assignment of observed points to predicted marker positions in one frame."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int
from scipy.optimize import linear_sum_assignment
from scipy.spatial.distance import cdist

from ..subject import Subject


def match_points(
    predicted: Float[np.ndarray, "M 3"],
    points: Float[np.ndarray, "N 3"],
    gates: Float[np.ndarray, "M N"] | Float[np.ndarray, "M 1"],
    discounts: Float[np.ndarray, "M N"] | None = None,
) -> Int[np.ndarray, "M"]:
    """Find the point of each marker, -1 where none is within its gate.

    The assignment has the least sum of squared distances in units of the gates, at most one for each marker.
    `discounts` multiply the squared distances: below one for pairs that other evidence supports.
    """
    if not len(points):
        return np.full(len(predicted), -1)
    cost = (cdist(predicted, points) / gates) ** 2
    inside = cost < 1.0
    cost = np.where(inside, cost if discounts is None else cost * discounts, 1.0)
    rows, columns = linear_sum_assignment(cost)
    found = np.full(len(predicted), -1)
    kept = inside[rows, columns]
    found[rows[kept]] = columns[kept]
    return found


def matched_targets(
    subject: Subject, points: Float[np.ndarray, "N 3"], matched: Int[np.ndarray, "*K M"]
) -> tuple[Float[Array, "*K M 3"], Bool[Array, "*K M"]]:
    """Return the positions of the matched markers, zero where there is none, and which markers have one."""
    shown = matched >= 0
    targets = np.where(shown[..., None], points[matched], 0.0)
    return jnp.asarray(targets, subject.offsets.dtype), jnp.asarray(shown)
