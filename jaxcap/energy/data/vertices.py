"""Energies whose residual is linear in the posed vertices."""

import abc

import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from ...body.body import Posed
from ..energy import AbstractEnergy, root


class AbstractVertexEnergy(AbstractEnergy):
    """An energy with R numbers for each of C chosen vertices, such as `n . (x_v - y)`, or for each of C places that lie
    between K vertices, `sum_k n_k . x_k - y`. It says how these numbers change with the vertices, and the body's skin
    knows how vertices move, so that none is differentiated automatically (`AbstractSkin.jacobian`)."""

    @abc.abstractmethod
    def slopes(self, posed: Posed) -> tuple[Int[Array, "C *K"], Float[Array, "C *K R 3"]]:
        """The vertices, and the derivative of the residual by their positions, at a posed body. The residual is in the same order,
        vertex by vertex or place by place, and depends on nothing else of the pose."""


def along_axes(weights: Float[Array, "C"]) -> Float[Array, "C 3 3"]:
    """Directions of differences `sqrt(w) (x - y)`."""
    return root(weights)[:, None, None] * jnp.eye(3, dtype=weights.dtype)
