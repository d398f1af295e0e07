"""Where learning stands."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from ..body.body import Body
from ..body.pose import Motion


class LearnState(NamedTuple):
    """Where learning stands after a round: all that is needed to go on."""

    body: Body
    #: the poses of the meshes
    motion: Motion
    #: left and right joints of which the bones stay equally long
    pairs: Int[np.ndarray, "P 2"]
    damping: float
    #: (step, Q) from the start on, Q in squared metres
    history: tuple[tuple[str, float], ...]
    round: int
    #: root mean square error over the number of rigid parts, metres; empty where it was not asked
    curve: Float[np.ndarray, "N"] = np.zeros(0)
