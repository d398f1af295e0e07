"""What methods that find centres share: the result, robust weights, and the weak prior."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

#: rounds of reweighting
ROUNDS = 12
#: relative to the information of the frames, the least that the prior may weigh: what exact data do
#: not tell is at the prior's place, what they tell is not moved by more than the machine's rounding
LEAST = 1e-10


class Centre(NamedTuple):
    """A centre as one method finds it."""

    in_parent: Float[np.ndarray, "3"]
    #: None where the child's frame is not known
    in_child: Float[np.ndarray, "3"] | None
    #: of `in_parent`, metres squared; holds the prior along what the data do not tell
    covariance: Float[np.ndarray, "3 3"]


def robust_weights(distances: Float[np.ndarray, "F"]) -> Float[np.ndarray, "F"]:
    """Weights by residual, Geman and McClure's at three times the median; one where all are exact."""
    scale = 3.0 * float(np.median(distances))
    return 1 / (1 + (distances / max(scale, 1e-9)) ** 2) ** 2


def prior_weight(information: float, variance: float, share: float, spread: float) -> float:
    """What the prior weighs in normal equations of F unit rows: frames count by their share that is
    independent."""
    return max(variance / (max(share, 1e-12) * spread**2), LEAST * information)
