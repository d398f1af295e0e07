"""Rounding of the state between two frames, so that runs which have come close to each other become equal.

A state is forgotten within some frames, up to rounding errors. These are enough to choose another nearest vertex at an edge of the surface,
and with it a pose that differs by a millimetre, for some frames. States that are rounded to a coarser grid are equal bit by bit
soon after runs have met, and stay equal.
"""

import equinox as eqx
import jax
import jax.numpy as jnp

from ..geometry import rotation
from .track_frame import TrackState

#: step of the grid of quaternions, metres and radians: hundredths of a millimetre at the end of a limb
STEP = 2.0**-15


@eqx.filter_jit
def round_state(state: TrackState) -> TrackState:
    """Round all numbers of a state to multiples of `STEP`, with unit quaternions."""
    rounded = jax.tree.map(lambda leaf: STEP * jnp.round(leaf / STEP), state)
    return eqx.tree_at(
        lambda s: s.estimate.pose.rotations, rounded, rotation.normalise(rounded.estimate.pose.rotations)
    )
