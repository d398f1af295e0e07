"""Distances between points of a posed surface and observed points."""

import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from ...body.body import Posed
from ..energy import mask_unweighted, safe_sqrt
from .vertices import AbstractVertexEnergy, axis_directions


class PointToPoint(AbstractVertexEnergy):
    """`sum_i w_i |x_i - y_i|^2` over pairs of a body's vertex and an observed point (Kineben, eq. 2; with
    posteriors as weights the M-step of eq. 29).

    `vertices (C,)` indices, `points (C, 3)` metres, `weights (C,)` at least zero.
    """

    vertices: Int[Array, "C"]
    points: Float[Array, "C 3"]
    weights: Float[Array, "C"]

    def residual(self, posed):
        differences = mask_unweighted(self.weights, posed.vertices[self.vertices] - self.points)
        return (safe_sqrt(self.weights)[:, None] * differences).reshape(-1)

    def vertex_jacobian(self, posed: Posed):
        del posed
        return self.vertices, axis_directions(self.weights)


class PointToPlane(AbstractVertexEnergy):
    """`sum_i w_i (n_i . (x_i - y_i))^2`: distance along fixed directions `n (C, 3)`, so that points slide
    along the surface (Chen and Medioni 1991).
    """

    vertices: Int[Array, "C"]
    points: Float[Array, "C 3"]
    normals: Float[Array, "C 3"]
    weights: Float[Array, "C"]

    def residual(self, posed):
        differences = posed.vertices[self.vertices] - self.points
        return safe_sqrt(self.weights) * jnp.sum(
            mask_unweighted(self.weights, self.normals * differences), -1
        )

    def vertex_jacobian(self, posed: Posed):
        del posed
        normals = mask_unweighted(self.weights, self.normals)
        return self.vertices, (safe_sqrt(self.weights)[:, None] * normals)[:, None]
