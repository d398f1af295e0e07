"""Animate a raw scan with the body fitted to it: its points are attached to the body's triangles.

Adaptation, section 4.2.3, direct animation of 3D reconstructed input data: a point of the scan is projected
onto the plane of the closest triangle. Its barycentric coordinates there and its distance along the
triangle's normal stay constant when the triangle moves. The body itself is not rendered, so the scan keeps
all of its detail.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ..arguments import checked
from ..body.body import Body, pose_body
from ..body.pose import Pose
from ..geometry.closest import nearest_on_surface


class Glue(eqx.Module):
    """Positions of N points relative to triangles."""

    #: vertices of each point's triangle
    corners: Int[Array, "N 3"]
    #: barycentric coordinates of the projection onto the triangle's plane; outside [0, 1] if it is outside
    #: the triangle
    barycentric: Float[Array, "N 3"]
    #: signed distance from the plane, metres
    normal_offsets: Float[Array, "N"]


@checked
def glue_scan(
    points: Float[Array | np.ndarray, "N 3"],
    vertices: Float[Array | np.ndarray, "V 3"],
    faces: Int[Array | np.ndarray, "F 3"],
    max_distance: float = np.inf,
) -> Glue:
    """Attach points to the closest triangles of a body in the pose of the scan, in NumPy and float64.

    **Arguments:** `vertices` of the posed body, metres, and its `faces`; `max_distance` is the largest distance of a
    point from the body, metres.

    **Raises:** `ValueError` if there are no faces or no points, a number is not finite, or a point is beyond
    reach.
    """
    import trimesh

    points, vertices, faces = np.asarray(points, float), np.asarray(vertices, float), np.asarray(faces)
    if len(faces) == 0:
        raise ValueError("The body has no faces; give a body with a surface.")
    if len(points) == 0:
        raise ValueError("The scan has no points; give a scan with at least one point.")
    if not (np.isfinite(points).all() and np.isfinite(vertices).all()):
        raise ValueError("Not all points and vertices are finite; remove those that are not.")
    sides = vertices[faces[:, 1:]] - vertices[faces[:, :1]]
    areas = np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1)
    # a degenerate triangle has no plane, and its sides belong to its neighbours too
    faces = faces[areas > 1e-12 * max(float(areas.max()), 1e-300)]
    nearest = nearest_on_surface(points, vertices, faces)
    far = nearest.distances > max_distance
    if far.any():
        raise ValueError(
            f"{int(far.sum())} of {len(points)} points of the scan are more than {max_distance:g} m from the body, the furthest "
            f"{nearest.distances.max():.3g} m; check the scan's unit, and that the body has the pose of the scan."
        )
    corners = faces[nearest.triangles]
    origin, first, second = np.moveaxis(vertices[corners], 1, 0)
    normal = np.cross(first - origin, second - origin)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    shares = trimesh.triangles.points_to_barycentric(vertices[corners], points, "cross")
    heights = np.sum((points - origin) * normal, 1)
    return Glue(jnp.asarray(corners), jnp.asarray(shares), jnp.asarray(heights))


@checked
@jax.jit
def glued_points(glue: Glue, vertices: Float[Array, "V 3"]) -> Float[Array, "N 3"]:
    """Compute the positions of attached points from the body's current vertices, metres; one frame,
    differentiable."""
    corners = vertices[glue.corners]
    foot = jnp.einsum("nc,nca->na", glue.barycentric, corners)
    normal = jnp.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    squared = jnp.sum(normal**2, 1, keepdims=True)
    # a triangle that a pose has collapsed has no normal; its points stay on it
    flat = squared < jnp.finfo(squared.dtype).tiny
    return foot + glue.normal_offsets[:, None] * normal / jnp.sqrt(jnp.where(flat, 1.0, squared))


@checked
@eqx.filter_jit
def animate_scan(glue: Glue, body: Body, pose: Pose) -> Float[Array, "N 3"]:
    """Pose the points of an attached scan with the body, metres; one frame."""
    return glued_points(glue, pose_body(body, pose).vertices)
