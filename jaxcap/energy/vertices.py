"""Energies whose residual is linear in the posed vertices."""

import abc

import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from .term import AbstractEnergy, root


class AbstractVertexEnergy(AbstractEnergy):
    """An energy with R numbers for each of C chosen vertices, `n . (x_v - y)` along fixed
    directions `n`: the body's skin knows how they move, so that none is differentiated
    automatically (`AbstractSkin.jacobian`)."""

    @abc.abstractmethod
    def slopes(self) -> tuple[Int[Array, "C"], Float[Array, "C R 3"]]:
        """The vertices, and the directions along which each is measured: the derivative of the
        residual by their positions. The residual is in the same order, vertex by vertex."""


def along_axes(weights: Float[Array, "C"]) -> Float[Array, "C 3 3"]:
    """Directions of differences `sqrt(w) (x - y)`."""
    return root(weights)[:, None, None] * jnp.eye(3, dtype=weights.dtype)
