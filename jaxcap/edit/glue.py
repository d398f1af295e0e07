"""A raw scan that moves with the body fitted to it: its points are glued to the body's triangles.

Adaptation, section 4.2.3, direct animation of 3D reconstructed input data: a point of the scan is projected onto the
plane of the closest triangle; its barycentric coordinates there and its distance along the triangle's normal stay,
wherever the triangle goes. The body itself is not seen, so nothing of the scan's detail is lost.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ..body.body import Body, pose_body
from ..body.pose import Pose
from ..geometry.closest import nearest_on_surface


class Glue(eqx.Module):
    """Where N points lie relative to triangles."""

    #: vertices of each point's triangle
    corners: Int[Array, "N 3"]
    #: barycentric coordinates of the foot of the perpendicular on the triangle's plane; they leave [0, 1] where it
    #: is beside the triangle
    shares: Float[Array, "N 3"]
    #: over the plane, metres
    heights: Float[Array, "N"]


def glue_scan(
    points: Float[Array | np.ndarray, "N 3"],
    vertices: Float[Array | np.ndarray, "V 3"],
    faces: Int[Array | np.ndarray, "F 3"],
    reach: float = np.inf,
) -> Glue:
    """Glue points to the closest triangles of a body as it was posed when they were scanned, in NumPy and float64.

    **Arguments:** `vertices` of the posed body, metres, and its `faces`; `reach` metres, beyond which a point is
    not of this body.

    **Raises:** `ValueError` where there are no faces or no points, a number is not finite, or a point is beyond reach.
    """
    import trimesh

    points, vertices, faces = np.asarray(points, float), np.asarray(vertices, float), np.asarray(faces)
    if len(faces) == 0:
        raise ValueError("The body has no faces; a scan is glued to a surface.")
    if len(points) == 0:
        raise ValueError("The scan has no points; there is nothing to glue.")
    if not (np.isfinite(points).all() and np.isfinite(vertices).all()):
        raise ValueError("Not all points and vertices are finite; remove those that are not.")
    sides = vertices[faces[:, 1:]] - vertices[faces[:, :1]]
    areas = np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1)
    # a triangle without an area has no plane, and a neighbour's side lies where its own do
    faces = faces[areas > 1e-12 * max(float(areas.max()), 1e-300)]
    nearest = nearest_on_surface(points, vertices, faces)
    far = nearest.distances > reach
    if far.any():
        raise ValueError(
            f"{int(far.sum())} of {len(points)} points of the scan are more than {reach:g} m from the body, the furthest "
            f"{nearest.distances.max():.3g} m; check the scan's unit, and that the body is posed in it."
        )
    corners = faces[nearest.triangles]
    origin, first, second = np.moveaxis(vertices[corners], 1, 0)
    normal = np.cross(first - origin, second - origin)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    shares = trimesh.triangles.points_to_barycentric(vertices[corners], points, "cross")
    heights = np.sum((points - origin) * normal, 1)
    return Glue(jnp.asarray(corners), jnp.asarray(shares), jnp.asarray(heights))


@jax.jit
def glued_points(glue: Glue, vertices: Float[Array, "V 3"]) -> Float[Array, "N 3"]:
    """Where glued points are, metres, with the body's vertices where they are now: one frame, differentiable."""
    corners = vertices[glue.corners]
    foot = jnp.einsum("nc,nca->na", glue.shares, corners)
    normal = jnp.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    squared = jnp.sum(normal**2, 1, keepdims=True)
    # a triangle that a pose has folded up has no normal; its points stay on it
    flat = squared < jnp.finfo(squared.dtype).tiny
    return foot + glue.heights[:, None] * normal / jnp.sqrt(jnp.where(flat, 1.0, squared))


@eqx.filter_jit
def animate_scan(glue: Glue, body: Body, pose: Pose) -> Float[Array, "N 3"]:
    """The points of a glued scan with the body in a pose, metres; one frame."""
    return glued_points(glue, pose_body(body, pose).vertices)
