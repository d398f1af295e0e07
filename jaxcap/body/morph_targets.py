"""Morph targets: displacements of a surface at rest, with weights that change over a motion."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float


class MorphTargets(NamedTuple):
    """Displacements of the vertices at rest: vertices move by their sum, weighted by those of the frame, before skinning."""

    names: tuple[str, ...]
    #: displacements at a weight of one, metres
    displacements: Float[np.ndarray, "K V 3"]
    #: the weights in each frame of a motion; no frames for a body at rest, where all weights are zero
    weights: Float[np.ndarray, "F K"]
