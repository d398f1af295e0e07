"""The connected, decimated surface on which a symmetry is searched."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Int
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

from ...geometry.laplacian import vertex_adjacency
from ...geometry.mesh import vertex_areas
from ...observe.meshes import MeshSequence
from ..decimated_meshes import decimate_meshes
from .intrinsic_surface import IntrinsicSurface, make_intrinsic_surface

#: the most vertices, and the least
MAX_VERTICES, MIN_VERTICES = 2000, 100
#: the least share of the largest connected component in the area of the surface
MIN_SHARE = 0.6


class CoarseSurface(NamedTuple):
    """The largest component of a decimated surface."""

    surface: IntrinsicSurface
    #: (S,) the vertices of the meshes that are its vertices
    kept: Int[np.ndarray, "S"]
    #: (V,) the nearest of its vertices to each vertex of the meshes
    rows: Int[np.ndarray, "V"]


def make_coarse_surface(meshes: MeshSequence) -> tuple[CoarseSurface | None, str]:
    """Decimate the meshes, and keep the largest component; None and the reason if it is too small.

    Vertices of other components, such as eyes, follow the nearest vertex of the largest one in the first mesh.
    """
    coarse = decimate_meshes(meshes, MAX_VERTICES)
    shapes, faces = np.asarray(coarse.meshes.vertices, float), np.asarray(coarse.meshes.faces)
    if len(faces) == 0:
        return None, "the surface has no triangles"
    count, labels = connected_components(vertex_adjacency(faces, shapes.shape[1]), directed=False)
    areas = np.bincount(labels, vertex_areas(shapes[0], faces), count)
    inside = labels == np.argmax(areas)
    share = float(areas.max() / max(areas.sum(), 1e-300))
    if share < MIN_SHARE:
        return None, (
            f"the surface has {(areas > 0).sum()} connected components, and the largest one has {100 * share:.0f} % of the area "
            f"(at least {100 * MIN_SHARE:.0f} % are needed)"
        )
    if inside.sum() < MIN_VERTICES:
        return None, f"the surface has {inside.sum()} vertices (at least {MIN_VERTICES} are needed)"
    chosen = np.flatnonzero(inside)
    place = np.cumsum(inside) - 1
    _, nearest = KDTree(shapes[0, chosen]).query(shapes[0])
    rows = np.where(inside, place, nearest)[coarse.nearest]
    own = place[faces[inside[faces].all(1)]]
    return CoarseSurface(make_intrinsic_surface(shapes[:, chosen], own), coarse.kept[chosen], rows), ""
