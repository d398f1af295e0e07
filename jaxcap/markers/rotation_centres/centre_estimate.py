"""What methods that find centres share: the result, robust weights, and the weak prior."""

from collections.abc import Callable
from typing import NamedTuple, TypeVar

import numpy as np
from jaxtyping import Float

State = TypeVar("State", bound=tuple)

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


def settle(
    step: Callable[[State], State], start: State, rounds: int, tolerance: float, least: int = 1
) -> State:
    """Repeat a `step` of reweighted least squares until what is looked for, the first entry of the state, moves by less
    than a tolerance: after `least` rounds or more, and `rounds` at most."""
    state = start
    for turn in range(rounds):
        old, state = state, step(state)
        if turn >= least and np.abs(state[0] - old[0]).max() < tolerance:
            break
    return state


def robust_weights(distances: Float[np.ndarray, "F"]) -> Float[np.ndarray, "F"]:
    """Weights by residual, Geman and McClure's at three times the median; one where all are exact."""
    scale = 3.0 * float(np.median(distances))
    return 1 / (1 + (distances / max(scale, 1e-9)) ** 2) ** 2


def prior_weight(information: float, variance: float, share: float, spread: float) -> float:
    """What the prior weighs in normal equations of F unit rows: frames count by their share that is
    independent."""
    return max(variance / (max(share, 1e-12) * spread**2), LEAST * information)
