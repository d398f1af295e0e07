"""Common parts of the centre estimators: result, robust weights, and weak prior."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

#: maximal number of reweightings
MAX_REWEIGHTINGS = 12
#: least weight of the prior relative to the information of the frames: it determines what exact data leave
#: open, and moves the rest by no more than rounding errors
MIN_PRIOR_WEIGHT = 1e-10


class CentreEstimate(NamedTuple):
    """A centre of rotation as one method estimates it."""

    in_parent: Float[np.ndarray, "3"]
    #: None where the child's frame is not known
    in_child: Float[np.ndarray, "3"] | None
    #: covariance of `in_parent`, metres squared; that of the prior along undetermined directions
    covariance: Float[np.ndarray, "3 3"]


def geman_mcclure_weights(distances: Float[np.ndarray, "F"]) -> Float[np.ndarray, "F"]:
    """Compute Geman-McClure weights of residuals with three times the median as scale.

    The weights are one where all residuals are exact.
    """
    scale = 3.0 * float(np.median(distances))
    return 1 / (1 + (distances / max(scale, 1e-9)) ** 2) ** 2


def prior_weight(
    information: float, variance: float, independent_fraction: float, prior_deviation: float
) -> float:
    """Compute the prior's weight in normal equations of unit rows.

    The frames are weighted by the share of them that is independent.
    """
    return max(
        variance / (max(independent_fraction, 1e-12) * prior_deviation**2), MIN_PRIOR_WEIGHT * information
    )
