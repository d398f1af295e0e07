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
from ..geometry.attachment import Attachment, attach_to_triangles, attached_positions
from ..geometry.closest import nearest_on_surface
from ..geometry.mesh import area_normals


@checked
def glue_scan(
    points: Float[Array | np.ndarray, "N 3"],
    vertices: Float[Array | np.ndarray, "V 3"],
    faces: Int[Array | np.ndarray, "F 3"],
    max_distance: float = np.inf,
) -> Attachment:
    """Attach points to the closest triangles of a body in the pose of the scan, in NumPy and float64.

    **Arguments:** `vertices` of the posed body, metres, and its `faces`; `max_distance` is the largest distance of a
    point from the body, metres.

    **Raises:** `ValueError` if there are no faces or no points, a number is not finite, or a point is beyond
    reach.
    """
    points, vertices, faces = np.asarray(points, float), np.asarray(vertices, float), np.asarray(faces)
    if len(faces) == 0:
        raise ValueError("The body has no faces; give a body with a surface.")
    if len(points) == 0:
        raise ValueError("The scan has no points; give a scan with at least one point.")
    if not (np.isfinite(points).all() and np.isfinite(vertices).all()):
        raise ValueError("Not all points and vertices are finite; remove those that are not.")
    areas = np.linalg.norm(area_normals(vertices[faces]), axis=1)
    # a degenerate triangle has no plane, and its sides belong to its neighbours too
    faces = faces[areas > 1e-12 * max(float(areas.max()), 1e-300)]
    nearest = nearest_on_surface(points, vertices, faces)
    far = nearest.distances > max_distance
    if far.any():
        raise ValueError(
            f"{int(far.sum())} of {len(points)} points of the scan are more than {max_distance:g} m from the body, the furthest "
            f"{nearest.distances.max():.3g} m; check the scan's unit, and that the body has the pose of the scan."
        )
    return jax.tree.map(jnp.asarray, attach_to_triangles(points, vertices, faces[nearest.triangles]))


@checked
@eqx.filter_jit
def animate_scan(attachment: Attachment, body: Body, pose: Pose) -> Float[Array, "N 3"]:
    """Pose the points of an attached scan with the body, metres; one frame."""
    return attached_positions(attachment, pose_body(body, pose).vertices)
