"""Penalty of body surface in space that a depth camera measured as empty."""

import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from ...body.body import Posed
from ...geometry.camera import project_points
from ...observe import DepthView
from .vertices import AbstractVertexEnergy

#: violations below these tolerances are noise: depth in front of the measured surface, and distance from the
#: silhouette, metres
FRONT_TOLERANCE, SIDE_TOLERANCE = 0.03, 0.01
#: beyond this a violation grows only linearly, metres
LINEAR_FROM = 0.1


class FreeSpace(AbstractVertexEnergy):
    """Violations of free space by vertices, in standard deviations, by one camera.

    A vertex in front of a measured surface of the person violates by the difference in depth; one in front of measured
    background by its distance from the silhouette. A vertex behind what was measured, outside of the image, or at a
    pixel without measurement violates nothing.
    """

    vertices: Int[Array, "C"]
    #: weight of each vertex
    weights: Float[Array, "C"]
    view: DepthView
    #: standard deviation of a violation, metres
    deviation: Float[Array, ""]

    def residual(self, posed: Posed) -> Float[Array, "C"]:
        return self._rows(posed)[0]

    def vertex_jacobian(self, posed: Posed):
        return self.vertices, self._rows(posed)[1][:, None, :]

    def _rows(self, posed: Posed) -> tuple[Float[Array, "C"], Float[Array, "C 3"]]:
        """Compute the residual of each vertex and its derivative by the vertex's position."""
        camera = self.view.camera
        points = posed.vertices[self.vertices]
        pixels, z = project_points(camera, points)
        size = jnp.array([camera.width, camera.height])
        inside = (z > 0) & jnp.all((pixels > 0) & (pixels < size - 1.0), -1)
        pixels, z = jnp.where(inside[:, None], pixels, 0.0), jnp.where(inside, z, 1.0)
        column, row = jnp.round(pixels).astype(int).T
        measured, is_background = self.view.depth[row, column], self.view.outside[row, column] > 0
        front = measured - z - FRONT_TOLERANCE
        in_front = inside & (measured > 0) & (front > 0)
        side, sideways = _silhouette_distance(self.view, pixels, z)
        violation = jnp.where(is_background, side - SIDE_TOLERANCE, front)
        violates = in_front & (violation > 0)
        direction = jnp.where(is_background[:, None], sideways, -camera.rotation[2])
        value, rate = _linear_beyond(jnp.where(violates, violation, 0.0))
        scale = jnp.sqrt(self.weights) / self.deviation
        return scale * value, (scale * rate)[:, None] * jnp.where(violates[:, None], direction, 0.0)


def _silhouette_distance(
    view: DepthView, pixels: Float[Array, "C 2"], z: Float[Array, "C"]
) -> tuple[Float[Array, "C"], Float[Array, "C 3"]]:
    """Compute the distance from the silhouette at the depth `z`, metres, and its slope by the point's position."""
    camera, focal = view.camera, jnp.mean(view.camera.focal)
    across, forward = camera.rotation[:2], camera.rotation[2]
    distance, slope = _bilinear(view.outside, pixels)
    rays = (pixels - camera.principal_point) / camera.focal
    # derivative of the pixel by the position
    rates = camera.focal[:, None] * (across - rays[..., None] * forward) / z[:, None, None]
    sideways = jnp.einsum("ck,cka->ca", slope, rates) * z[:, None] + distance[:, None] * forward
    return distance * z / focal, sideways / focal


def _linear_beyond(violation: Float[Array, "C"]) -> tuple[Float[Array, "C"], Float[Array, "C"]]:
    """Compute `r`, whose square is that of a violation `v` up to `c = LINEAR_FROM`, then `2 c v - c^2`; and its slope."""
    far = violation > LINEAR_FROM
    root = jnp.sqrt(jnp.where(far, 2 * LINEAR_FROM * violation - LINEAR_FROM**2, 1.0))
    return jnp.where(far, root, violation), jnp.where(far, LINEAR_FROM / root, 1.0)


def _bilinear(image: Float[Array, "H W"], pixels: Float[Array, "C 2"]):
    """Interpolate an image, and its slope by column and row."""
    corner = jnp.clip(jnp.floor(pixels), 0, jnp.array(image.shape[::-1]) - 2).astype(int)
    u, v = (pixels - corner).T
    x, y = corner.T
    a, b, c, d = image[y, x], image[y, x + 1], image[y + 1, x], image[y + 1, x + 1]
    value = (1 - v) * ((1 - u) * a + u * b) + v * ((1 - u) * c + u * d)
    slope = jnp.stack([(1 - v) * (b - a) + v * (d - c), (1 - u) * (c - a) + u * (d - b)], -1)
    return value, slope
