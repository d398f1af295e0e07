"""Transfer of a body learned on a decimated mesh to all vertices."""

import equinox as eqx
import numpy as np
from jaxtyping import Float, Int

from ..body.body import Body
from ..body.pose import Pose
from ..body.skin import AbstractSkin
from ..geometry.closest import closest_barycentric
from ..geometry.mesh import corners_at_vertices
from ..observe.meshes import MeshSequence
from .decimated_meshes import DecimatedMeshes
from .weights.rest_vertices import fit_rest_vertices


def corners_of_kept(
    coarse: DecimatedMeshes, shape: Float[np.ndarray, "V 3"]
) -> tuple[Int[np.ndarray, "V 3"], Float[np.ndarray, "V 3"]]:
    """Find, for each vertex of the mesh, the nearest point on the triangles of the decimated mesh that meet at its nearest kept vertex.

    Only these triangles are searched, so that a vertex of one limb is not related to another limb that it touches.

    Returns the corners, as positions in `coarse.kept`, and the barycentric coordinates of the point. A vertex without such
    triangles has three times the nearest kept one.

    **Arguments:** `shape` is any mesh of the sequence, metres.
    """
    faces = np.asarray(coarse.meshes.faces)
    vertices, places = corners_at_vertices(faces, coarse.nearest)
    around = faces[places // 3]
    barycentric, squared = closest_barycentric(shape[coarse.kept][around], shape[vertices])
    # the first row of each vertex is that of its nearest triangle
    rows = np.lexsort([squared, vertices])
    found, first = np.unique(vertices[rows], return_index=True)
    corners = np.repeat(coarse.nearest[:, None], 3, axis=1)
    shares = np.tile([1.0, 0.0, 0.0], (len(shape), 1))
    corners[found], shares[found] = around[rows[first]], barycentric[rows[first]]
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
