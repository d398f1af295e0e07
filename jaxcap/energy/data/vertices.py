"""Energies with a residual that is linear in the posed vertices."""

import abc

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from ...body.body import Posed
from ..energy import AbstractEnergy, safe_sqrt


class AbstractVertexEnergy(AbstractEnergy):
    """An energy with R residuals for each of C chosen vertices, such as `n . (x_v - y)`, or for each of C
    points between K vertices, `sum_k n_k . x_k - y`.

    It gives the derivative of these residuals by the vertices, and the body's skin gives that of the
    vertices, so that no automatic differentiation is needed (`AbstractSkin.jacobian`).
    """

    @abc.abstractmethod
    def vertex_jacobian(self, posed: Posed) -> tuple[Int[Array, "C *K"], Float[Array, "C *K R 3"]]:
        """Get the vertices, and the derivative of the residual by their positions, at a posed body.

        The residual has the same order, vertex by vertex or point by point, and depends on nothing else of
        the pose.
        """


class AbstractVertexPenalty(AbstractVertexEnergy):
    """An energy with one residual for each of some vertices, which depends on the position of this vertex only."""

    vertices: eqx.AbstractVar[Int[Array, "C"]]

    @abc.abstractmethod
    def rows(self, posed: Posed) -> tuple[Float[Array, "C"], Float[Array, "C 3"]]:
        """Compute the residual of each vertex and its derivative by the vertex's position."""

    def residual(self, posed: Posed) -> Float[Array, "C"]:
        return self.rows(posed)[0]

    def vertex_jacobian(self, posed: Posed) -> tuple[Int[Array, "C"], Float[Array, "C 1 3"]]:
        return self.vertices, self.rows(posed)[1][:, None, :]


def axis_directions(weights: Float[Array, "C"]) -> Float[Array, "C 3 3"]:
    """Compute the directions of differences `sqrt(w) (x - y)`."""
    return safe_sqrt(weights)[:, None, None] * jnp.eye(3, dtype=weights.dtype)
