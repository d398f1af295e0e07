"""Points attached to the triangles of a body's surface, such as markers on skin."""

import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from ...body.body import Posed
from ..energy import AbstractEnergy, safe_sqrt


class SurfaceLandmarks(AbstractEnergy):
    """`sum_i w_i |p_i - y_i|^2`: points at barycentric `barycentric` of their triangles' `corners` and `heights`
    above them, metres, with positions `targets`.

    A weight of zero marks a point that was not observed.
    """

    corners: Int[Array, "C 3"]
    barycentric: Float[Array, "C 3"]
    heights: Float[Array, "C"]
    targets: Float[Array, "C 3"]
    weights: Float[Array, "C"]

    def residual(self, posed):
        places = surface_points(posed, self.corners, self.barycentric, self.heights)
        return (safe_sqrt(self.weights)[:, None] * (places - self.targets)).reshape(-1)


def surface_points(
    posed: Posed, corners: Int[Array, "C 3"], barycentric: Float[Array, "C 3"], heights: Float[Array, "C"]
) -> Float[Array, "C 3"]:
    """Compute `sum_k s_k x_k + h n` over the corners `x` of each point's triangle with its unit normal `n`.

    Only the corners are posed, so that a derivative does not involve the whole skin.
    """
    body, chosen = posed.body, corners.reshape(-1)
    few = body.skin.take(chosen)
    x = few.deform(body.vertices[chosen], body.skeleton, posed.pose, posed.transforms).reshape(-1, 3, 3)
    across = jnp.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0])
    squared = jnp.sum(across * across, -1, keepdims=True)
    # a triangle that a pose has collapsed to a line has no normal
    degenerate = squared < jnp.finfo(x.dtype).tiny
    normals = jnp.where(degenerate, 0.0, across) / jnp.sqrt(jnp.where(degenerate, 1.0, squared))
    return jnp.einsum("ck,cka->ca", barycentric, x) + heights[:, None] * normals
