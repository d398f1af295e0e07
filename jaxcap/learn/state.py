"""The state of learning between rounds."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from ..body.body import Body
from ..body.pose import Motion
from .skeleton.given_centres import GivenCentres


class LearnState(NamedTuple):
    """The state of learning after a round: sufficient to resume."""

    body: Body
    #: the poses of the meshes
    motion: Motion
    #: pairs of left and right joints whose bones stay equally long
    left_right_pairs: Int[np.ndarray, "P 2"]
    damping: float
    #: (step, Q) from the start, Q in squared metres
    history: tuple[tuple[str, float], ...]
    round: int
    #: root mean square error over the number of rigid parts, metres; empty if it was not computed
    curve: Float[np.ndarray, "N"] = np.zeros(0)
    #: where a given skeleton or the anatomy has the joints; None if they were found from the motion
    given: GivenCentres | None = None
    #: the share by which parts in pairs raised the error when parts were found; 0 if the surface has no symmetry
    symmetry_cost: float = 0.0
