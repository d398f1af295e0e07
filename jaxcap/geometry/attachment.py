"""Points attached to the triangles of a surface, which follow every shape of the surface."""

from typing import Any

import equinox as eqx
import numpy as np
from jaxtyping import Array, Float, Int

from ..arguments import checked
from .mesh import Floats, area_normals, array_module, unit_vectors


class Attachment(eqx.Module):
    """N points relative to the triangles of a surface, valid for any shape with the same triangles."""

    #: vertices of each point's triangle
    corners: Int[Array | np.ndarray, "N 3"]
    #: barycentric coordinates of the projection onto the triangle's plane; outside [0, 1] if it is outside
    #: the triangle
    barycentric: Float[Array | np.ndarray, "N 3"]
    #: signed distances from the plane along the triangle's normal, metres
    heights: Float[Array | np.ndarray, "N"]


@checked
def attach_points(
    points: Float[np.ndarray, "N 3"], vertices: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"]
) -> Attachment:
    """Attach points to the nearest triangles of a surface, in metres or any other unit.

    Triangles without area are left out. The attachment reproduces the points on this shape of the surface.
    """
    import trimesh

    faces = faces[np.linalg.norm(area_normals(vertices[faces]), axis=1) > 0]
    surface = trimesh.Trimesh(vertices, faces, process=False)
    _, _, nearest = trimesh.proximity.closest_point(surface, points)
    return attach_to_triangles(points, vertices, faces[nearest])


def attach_to_triangles(
    points: Float[np.ndarray, "N 3"], vertices: Float[np.ndarray, "V 3"], corners: Int[np.ndarray, "N 3"]
) -> Attachment:
    """Attach each point to its own triangle, which has an area and is given by its `corners`."""
    import trimesh

    triangles = vertices[corners]
    barycentric = trimesh.triangles.points_to_barycentric(triangles, points, "cross")
    normals = unit_vectors(area_normals(triangles))
    return Attachment(corners, barycentric, np.sum((points - triangles[:, 0]) * normals, axis=1))


@checked
def attached_positions(attachment: Attachment, vertices: Float[Floats, "V 3"]) -> Float[Floats, "N 3"]:
    """Compute the positions of attached points, metres, from the surface's vertices; differentiable.

    Points on a triangle that has collapsed to a line or a point lie on it.
    """
    triangles: Any = vertices[attachment.corners]
    return positions_on_triangles(attachment, triangles)


def positions_on_triangles(attachment: Attachment, triangles: Float[Floats, "N 3 3"]) -> Float[Floats, "N 3"]:
    """Compute the positions of attached points from the corners of their triangles, metres."""
    foot = array_module(triangles).einsum("nc,nca->na", attachment.barycentric, triangles)
    return foot + attachment.heights[:, None] * unit_vectors(area_normals(triangles))
