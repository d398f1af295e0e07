"""Surface in front of what a camera measured, and outside of the person's silhouette."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ...body.body import Body, Posed
from ...geometry.camera import project
from ...observe import DepthView
from .vertices import AbstractVertexEnergy

#: number of tested vertices
NUM_TESTED = 800
#: violations up to these are noise: in front of the measured surface, and beside the silhouette, metres
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
        pixels, z = project(camera, points)
        inside = (z > 0) & jnp.all(
            (pixels > 0) & (pixels < jnp.array([camera.width, camera.height]) - 1.0), -1
        )
        pixels = jnp.where(inside[:, None], pixels, 0.0)
        column, row = jnp.round(pixels).astype(int).T
        there, beside = self.view.depth[row, column], self.view.outside[row, column]
        front = there - z - FRONT_TOLERANCE
        in_front = inside & (there > 0) & (front > 0)
        over = in_front & (beside > 0)
        metres = z / jnp.mean(camera.focal)
        distance, slope = _bilinear(self.view.outside, pixels)
        side = distance * metres - SIDE_TOLERANCE
        amount = jnp.where(over, jnp.maximum(side, 0.0), jnp.where(in_front & ~over, front, 0.0))
        # d pixels / d x, rows of the camera's rotation
        r = camera.rotation
        safe = jnp.where(inside, z, 1.0)
        across = (
            camera.focal[None, :, None]
            * (r[None, :2] - ((pixels - camera.principal_point) / camera.focal)[..., None] * r[2])
            / safe[:, None, None]
        )
        sideways = jnp.einsum("ck,cka->ca", slope, across) * metres[:, None] + distance[:, None] * r[
            2
        ] / jnp.mean(camera.focal)
        direction = jnp.where(
            (over & (side > 0))[:, None], sideways, jnp.where((in_front & ~over)[:, None], -r[2], 0.0)
        )
        # squares up to a limit, then linear: r = sqrt(2 c d - c^2)
        far = amount > LINEAR_FROM
        root = jnp.sqrt(jnp.where(far, 2 * LINEAR_FROM * amount - LINEAR_FROM**2, 1.0))
        value = jnp.where(far, root, amount)
        rate = jnp.where(far, LINEAR_FROM / root, 1.0)
        scale = jnp.sqrt(self.weights) / self.deviation
        return scale * value, (scale * rate)[:, None] * direction


def _bilinear(image: Float[Array, "H W"], pixels: Float[Array, "C 2"]):
    """Interpolate an image, and its slope by column and row."""
    corner = jnp.clip(jnp.floor(pixels), 0, jnp.array(image.shape[::-1]) - 2).astype(int)
    u, v = (pixels - corner).T
    x, y = corner.T
    a, b, c, d = image[y, x], image[y, x + 1], image[y + 1, x], image[y + 1, x + 1]
    value = (1 - v) * ((1 - u) * a + u * b) + v * ((1 - u) * c + u * d)
    slope = jnp.stack([(1 - v) * (b - a) + v * (d - c), (1 - u) * (c - a) + u * (d - b)], -1)
    return value, slope


def sample_tested(body: Body, count: int = NUM_TESTED) -> Int[np.ndarray, "C"]:
    """Choose vertices spread over the surface, by area."""
    rows = np.linspace(0, len(body.vertices) - 1, min(count, len(body.vertices))).astype(int)
    return np.unique(rows)
