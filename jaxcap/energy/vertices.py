"""Energies whose residual is linear in the posed vertices."""

import abc

import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from .term import AbstractEnergy, root


class AbstractVertexEnergy(AbstractEnergy):
    """An energy with R numbers for each of C chosen vertices, `n . (x_v - y)` along fixed
    directions `n`, or for each of C places that lie between K vertices, `sum_k n_k . x_k - y`: the body's skin knows how
    these move, so that none is differentiated automatically (`AbstractSkin.jacobian`)."""

    @abc.abstractmethod
    def slopes(self) -> tuple[Int[Array, "C *K"], Float[Array, "C *K R 3"]]:
        """The vertices, and the directions along which each is measured: the derivative of the
        residual by their positions. The residual is in the same order, vertex by vertex or place by place."""


def along_axes(weights: Float[Array, "C"]) -> Float[Array, "C 3 3"]:
    """Directions of differences `sqrt(w) (x - y)`."""
    return root(weights)[:, None, None] * jnp.eye(3, dtype=weights.dtype)
