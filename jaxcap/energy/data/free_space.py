"""Penalty of body surface in space that a depth camera measured as empty."""

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from ...body.body import Posed
from ...geometry.camera import project_points
from ...observe import DepthView
from .vertices import AbstractVertexPenalty

#: violations below these tolerances are noise: depth in front of the measured surface, and distance from the
#: silhouette, metres
FRONT_TOLERANCE, SIDE_TOLERANCE = 0.03, 0.01
#: beyond this a violation grows only linearly, metres
LINEAR_FROM = 0.1


class FreeSpace(AbstractVertexPenalty):
    """Violations of free space by vertices, in standard deviations, by one camera.

    A vertex in front of what was measured at its pixel is in free space. It violates by the distance that it is in front,
    or by the distance sideways to the person's nearest pixel that is not farther than the vertex, whichever is less:
    a vertex next to a hand in front of the trunk is moved to the hand, not into the trunk. A vertex behind what was
    measured, outside of the image, or at a pixel without measurement violates nothing.
    """

    vertices: Int[Array, "C"]
    #: weight of each vertex
    weights: Float[Array, "C"]
    view: DepthView
    #: standard deviation of a violation, metres
    deviation: Float[Array, ""]

    def rows(self, posed: Posed) -> tuple[Float[Array, "C"], Float[Array, "C 3"]]:
        camera = self.view.camera
        points = posed.vertices[self.vertices]
        pixels, z = project_points(camera, points)
        size = jnp.array([camera.width, camera.height])
        inside = (z > 0) & jnp.all((pixels > 0) & (pixels < size - 1.0), -1)
        pixels, z = jnp.where(inside[:, None], pixels, 0.0), jnp.where(inside, z, 1.0)
        column, row = jnp.round(pixels).astype(int).T
        measured = self.view.depth[row, column]
        is_background = self.view.distances[-1, row, column] > 0
        front = measured - z - FRONT_TOLERANCE
        side, sideways = _distance_from_person(self.view, pixels, z, is_background)
        side = side - SIDE_TOLERANCE
        nearer = is_background | (side < front)
        violation = jnp.where(nearer, side, front)
        violates = inside & (measured > 0) & (front > 0) & (violation > 0)
        direction = jnp.where(nearer[:, None], sideways, -camera.rotation[2])
        value, rate = linear_beyond(jnp.where(violates, violation, 0.0))
        scale = jnp.sqrt(self.weights) / self.deviation
        return scale * value, (scale * rate)[:, None] * jnp.where(violates[:, None], direction, 0.0)


def _distance_from_person(
    view: DepthView, pixels: Float[Array, "C 2"], z: Float[Array, "C"], is_background: Bool[Array, "C"]
) -> tuple[Float[Array, "C"], Float[Array, "C 3"]]:
    """Compute the distance to the person, metres, and its slope by the point's position.

    The person's pixels that are not farther than a level are a plate at this level, of which the nearest counts. In front
    of the background the distance is that from the silhouette.
    """
    camera, focal = view.camera, jnp.mean(view.camera.focal)
    across, forward = camera.rotation[:2], camera.rotation[2]
    rays = (pixels - camera.principal_point) / camera.focal
    # derivative of the pixel by the position
    rates = camera.focal[:, None] * (across - rays[..., None] * forward) / z[:, None, None]
    value, slope = _bilinear(view.distances, pixels)
    sideways = value * z / focal
    behind = jnp.maximum(view.levels[:, None] - z - FRONT_TOLERANCE, 0.0)
    behind = jnp.where(is_background & (jnp.arange(len(behind)) == len(behind) - 1)[:, None], 0.0, behind)
    squared = sideways**2 + behind**2
    level = jnp.where(is_background, len(behind) - 1, jnp.argmin(squared, 0))
    value, slope, sideways, behind, squared = (
        jnp.take_along_axis(leaf, level.reshape(1, -1, *[1] * (leaf.ndim - 2)), 0)[0]
        for leaf in (value, slope, sideways, behind, squared)
    )
    rate = (jnp.einsum("ck,cka->ca", slope, rates) * z[:, None] + value[:, None] * forward) / focal
    distance = jnp.sqrt(jnp.where(squared > 0, squared, 1.0))
    slope = (sideways[:, None] * rate - behind[:, None] * forward) / distance[:, None]
    return jnp.where(squared > 0, distance, 0.0), slope


def linear_beyond(violation: Float[Array, "C"]) -> tuple[Float[Array, "C"], Float[Array, "C"]]:
    """Compute `r`, whose square is that of a violation `v` up to `c = LINEAR_FROM`, then `2 c v - c^2`; and its slope."""
    far = violation > LINEAR_FROM
    root = jnp.sqrt(jnp.where(far, 2 * LINEAR_FROM * violation - LINEAR_FROM**2, 1.0))
    return jnp.where(far, root, violation), jnp.where(far, LINEAR_FROM / root, 1.0)


def _bilinear(images: Float[Array, "L H W"], pixels: Float[Array, "C 2"]):
    """Interpolate images, and compute their slopes by column and row; `(L, C)` and `(L, C, 2)`."""
    corner = jnp.clip(jnp.floor(pixels), 0, jnp.array(images.shape[:0:-1]) - 2).astype(int)
    u, v = (pixels - corner).T
    x, y = corner.T
    a, b, c, d = images[:, y, x], images[:, y, x + 1], images[:, y + 1, x], images[:, y + 1, x + 1]
    value = (1 - v) * ((1 - u) * a + u * b) + v * ((1 - u) * c + u * d)
    slope = jnp.stack([(1 - v) * (b - a) + v * (d - c), (1 - u) * (c - a) + u * (d - b)], -1)
    return value, slope
