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


@eqx.filter_jit
def round_state(state: TrackState, step: float) -> TrackState:
    """Round all numbers of a state to multiples of a step, with unit quaternions."""
    rounded = jax.tree.map(lambda leaf: step * jnp.round(leaf / step), state)
    return eqx.tree_at(
        lambda s: s.estimate.pose.rotations, rounded, rotation.normalise(rounded.estimate.pose.rotations)
    )
