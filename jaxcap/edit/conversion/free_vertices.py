"""Registration of a surface with free vertices to another one: nearest points, and a smooth displacement."""

import numpy as np
import scipy.sparse
from jaxtyping import Bool, Float, Int

from ...geometry.closest import SurfacePoints, nearest_on_surface, positions_on_surface
from ...geometry.laplacian import laplacian_matrix, vertex_adjacency
from ...geometry.linear import factor_sparse
from ...geometry.mesh import vertex_normals

#: weights of the Laplacian of the displacement by rounds, against the squared distance of a vertex
STIFFNESS = tuple(np.geomspace(100.0, 0.3, 10))
#: largest angle between the normals of a vertex and its nearest point, degrees
MAX_ANGLE = 60.0


def register_vertices(
    vertices: Float[np.ndarray, "W 3"],
    faces: Int[np.ndarray, "S 3"],
    surface: Float[np.ndarray, "V 3"],
    triangles: Int[np.ndarray, "T 3"],
    reach: float,
) -> Float[np.ndarray, "W 3"]:
    """Move the vertices of a surface onto another one, smoothly: minimise `sum w |x + d - y|^2 + a |L d|^2` in rounds.

    `y` is the nearest point of the other surface in each round, `L` the uniform Laplacian (Sorkine et al. 2004), and `a`
    decreases. Vertices without a nearest point with a similar normal within `reach`, metres, follow their neighbours.
    """
    laplacian = laplacian_matrix(vertex_adjacency(faces, len(vertices)))
    bending = (laplacian.T @ laplacian).tocsr()
    moved = vertices
    for stiffness in STIFFNESS:
        nearest, alike = find_counterparts(moved, faces, surface, triangles, reach)
        weights = np.where(alike, reach / np.hypot(reach, nearest.distances), 0.0)
        gaps = np.where(alike[:, None], positions_on_surface(nearest, surface, triangles) - vertices, 0.0)
        # the last term keeps parts without any nearest point in place
        matrix = scipy.sparse.diags_array(weights + 1e-9) + stiffness * bending
        moved = vertices + factor_sparse(matrix).solve(weights[:, None] * gaps)
    return moved


def find_counterparts(
    vertices: Float[np.ndarray, "W 3"],
    faces: Int[np.ndarray, "S 3"],
    surface: Float[np.ndarray, "V 3"],
    triangles: Int[np.ndarray, "T 3"],
    reach: float,
) -> tuple[SurfacePoints, Bool[np.ndarray, "W"]]:
    """Find the nearest points on another surface, and which of them are within `reach`, metres, with a similar normal."""
    nearest = nearest_on_surface(vertices, surface, triangles, reach)
    normals = np.asarray(vertex_normals(vertices, faces))
    there = np.asarray(vertex_normals(surface, triangles))[triangles[nearest.triangles]]
    agreement = np.einsum("wk,wka,wa->w", nearest.barycentric, there, normals)
    return nearest, np.isfinite(nearest.distances) & (agreement > np.cos(np.radians(MAX_ANGLE)))
