"""Transfer of a body learned on a decimated mesh to all vertices."""

import equinox as eqx
import numpy as np
import trimesh
from jaxtyping import Float, Int

from ..body.body import Body
from ..body.pose import Pose
from ..body.skin import AbstractSkin
from ..body.skin.interpolate import clamp_barycentric
from ..geometry.mesh import area_normals
from ..observe.meshes import MeshSequence
from .decimated_meshes import DecimatedMeshes
from .weights.rest_vertices import fit_rest_vertices

#: least area of a triangle, as a share of the square of its longest edge
MIN_AREA = 1e-6


def corners_of_kept(
    coarse: DecimatedMeshes, shape: Float[np.ndarray, "V 3"]
) -> tuple[Int[np.ndarray, "V 3"], Float[np.ndarray, "V 3"]]:
    """Find, for each vertex of the mesh, the nearest point on the triangles of the decimated mesh that meet at its nearest kept vertex.

    Only these triangles are searched, so that a vertex of one limb is not related to another limb that it touches.

    Returns the corners, as positions in `coarse.kept`, and the barycentric coordinates of the point. A vertex without such
    triangles has three times the nearest kept one.

    **Arguments:** `shape` is any mesh of the sequence, metres.
    """
    count, faces = len(coarse.kept), np.asarray(coarse.meshes.faces)
    corners_at = shape[coarse.kept][faces]
    longest = np.max(np.sum((corners_at - np.roll(corners_at, 1, axis=1)) ** 2, axis=2), axis=1)
    # barycentric coordinates need an area
    faces = faces[np.linalg.norm(area_normals(corners_at), axis=1) > MIN_AREA * longest]
    order = np.argsort(faces.ravel(), kind="stable")
    triangles, starts = order // 3, np.searchsorted(faces.ravel()[order], np.arange(count + 1))
    number = np.diff(starts)[coarse.nearest]
    vertices = np.repeat(np.arange(len(shape)), number)
    within = np.arange(len(vertices)) - np.repeat(np.cumsum(number) - number, number)
    tried = triangles[np.repeat(starts[coarse.nearest], number) + within]
    around, points = shape[coarse.kept][faces[tried]], shape[vertices]
    closest = trimesh.triangles.closest_point(around, points)
    distances = np.linalg.norm(closest - points, axis=1)
    # the first row of each vertex is that of its nearest triangle
    rows = np.lexsort([distances, vertices])
    found, first = np.unique(vertices[rows], return_index=True)
    chosen = rows[first]
    corners = np.repeat(coarse.nearest[:, None], 3, axis=1)
    shares = np.tile([1.0, 0.0, 0.0], (len(shape), 1))
    corners[found] = faces[tried[chosen]]
    shares[found] = clamp_barycentric(
        trimesh.triangles.points_to_barycentric(around[chosen], closest[chosen], "cross")
    )
    return corners, shares


def interpolate_skin(body: Body, coarse: DecimatedMeshes, shape: Float[np.ndarray, "V 3"]) -> AbstractSkin:
    """Interpolate the weights of a body of the kept vertices at all vertices.

    **Arguments:** `shape` is any mesh of the sequence, metres.
    """
    return body.skin.transfer(*corners_of_kept(coarse, shape), body.skeleton)


def transfer_to_all_vertices(body: Body, poses: Pose, coarse: DecimatedMeshes, meshes: MeshSequence) -> Body:
    """Interpolate the weights of a body of the kept vertices, and fit the rest position of each vertex to its own positions in
    the meshes."""
    skin = interpolate_skin(body, coarse, np.asarray(meshes.vertices[0], float))
    # the fitted rest position does not depend on the given one
    whole = Body(body.skeleton, skin, meshes.vertices[0], meshes.faces)
    return eqx.tree_at(lambda b: b.vertices, whole, fit_rest_vertices(whole, poses, meshes.vertices))
