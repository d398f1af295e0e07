"""Fewer vertices of the same meshes, on which learning begins: most of the way at a fraction of the cost."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Int
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from ..geometry.laplacian import vertex_adjacency
from ..observe import MeshSequence

#: meshes are thinned until they have no more vertices than this
ENOUGH = 4000


class Coarse(NamedTuple):
    """Some vertices of a mesh sequence, joined by triangles across their neighbourhoods."""

    meshes: MeshSequence
    #: (S,) which vertices are kept
    kept: Int[np.ndarray, "S"]
    #: (V,) the place among the kept ones of the one nearest to each vertex
    nearest: Int[np.ndarray, "V"]


def coarsen(meshes: MeshSequence, enough: int = ENOUGH) -> Coarse:
    """Keep vertices no two of which are neighbours, again and again until there are few enough.

    Vertices stay what they are, so that a body learned from them is one of the whole mesh; where a
    mesh is dense, as at hands and faces, it stays denser. Nothing is left out of a mesh that is
    small already.
    """
    faces, count = np.asarray(meshes.faces), meshes.vertices.shape[1]
    kept = nearest = np.arange(count)
    while len(kept) > enough:
        adjacency = vertex_adjacency(faces, len(kept))
        chosen = _independent(adjacency)
        if len(chosen) == len(kept):
            break
        # hops, so that every vertex follows one of its neighbours
        _, _, source = dijkstra(
            adjacency, indices=chosen, min_only=True, unweighted=True, return_predecessors=True
        )
        owner = np.searchsorted(chosen, source)
        corners = owner[faces]
        apart = (
            (corners[:, 0] != corners[:, 1])
            & (corners[:, 1] != corners[:, 2])
            & (corners[:, 2] != corners[:, 0])
        )
        faces = _unique(corners[apart])
        kept, nearest = kept[chosen], owner[nearest]
    fewer = MeshSequence(meshes.vertices[:, kept], jnp.asarray(faces, meshes.faces.dtype), meshes.rate)
    return Coarse(fewer, kept, nearest)


def coarse_alpha(alpha: float, fine: int, coarse: int) -> float:
    """The weight of shape on a coarse mesh that counts smooth errors as `alpha` does on the fine one:
    a Laplacian grows with the square of the edges' length, its square with the fourth power."""
    return alpha * (coarse / fine) ** 2


def _independent(adjacency: csr_array) -> Int[np.ndarray, "S"]:
    """A set of vertices, to which none can be added, no two of which are neighbours, by their order."""
    open_ = np.ones(len(adjacency.indptr) - 1, bool)
    chosen = []
    for vertex in range(len(open_)):
        if open_[vertex]:
            chosen.append(vertex)
            open_[adjacency.indices[adjacency.indptr[vertex] : adjacency.indptr[vertex + 1]]] = False
    return np.array(chosen)


def _unique(faces: Int[np.ndarray, "T 3"]) -> Int[np.ndarray, "T 3"]:
    _, first = np.unique(np.sort(faces, axis=1), axis=0, return_index=True)
    return faces[np.sort(first)]
