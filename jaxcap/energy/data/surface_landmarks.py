"""Points attached to the triangles of a body's surface, such as markers on skin."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from ...body.body import Posed
from ...geometry.attachment import Attachment, positions_on_triangles
from ..energy import AbstractEnergy, safe_sqrt


class SurfaceLandmarks(AbstractEnergy):
    """`sum_i w_i |p_i - y_i|^2`: points `p` attached to the surface, with positions `targets`, metres.

    A weight of zero marks a point that was not observed.
    """

    attachment: Attachment
    targets: Float[Array, "C 3"]
    weights: Float[Array, "C"]

    def residual(self, posed):
        positions = surface_points(posed, self.attachment)
        return (safe_sqrt(self.weights)[:, None] * (positions - self.targets)).reshape(-1)


def surface_points(posed: Posed, attachment: Attachment) -> Float[Array, "C 3"]:
    """Compute the positions of points attached to a posed body, metres.

    Only the corners of their triangles are posed, so that a derivative does not involve the whole skin.
    """
    body, chosen = posed.body, jnp.asarray(attachment.corners).reshape(-1)
    few = body.skin.take(chosen)
    corners = few.deform(body.vertices[chosen], body.skeleton, posed.pose, posed.transforms)
    return positions_on_triangles(attachment, corners.reshape(-1, 3, 3))
