"""Fewer vertices of the same meshes, on which learning begins: most of the way at a fraction of the cost."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from ..geometry.mesh import mesh_edges
from ..observe import MeshSequence

#: meshes are thinned until they have no more vertices than this, or than so many for each part where their number is known
ENOUGH, FOR_A_PART, LEAST = 4000, 105, 1000
#: the share of the edges that are short at first, how that grows, and how often beyond the longest edge
SHORT, STRETCH, MOST = 0.1, 1.25, 8


class Coarse(NamedTuple):
    """Some vertices of a mesh sequence, joined by triangles across their neighbourhoods."""

    meshes: MeshSequence
    #: (S,) which vertices are kept
    kept: Int[np.ndarray, "S"]
    #: (V,) the place among the kept ones of the one nearest to each vertex
    nearest: Int[np.ndarray, "V"]


def coarsen(meshes: MeshSequence, enough: int = ENOUGH) -> Coarse:
    """Keep vertices no two of which are joined by a short edge, where short grows until there are few
    enough.

    Vertices stay what they are, so that a body learned from them is one of the whole mesh. Short is
    meant against the root of the spacing that there was: what is dense, like a face, is thinned
    first, but hands stay denser than a trunk, as their bones are smaller. Nothing is left out of a
    mesh that is small already.
    """
    faces, shape = np.asarray(meshes.faces), np.asarray(meshes.vertices[0], float)
    kept = nearest = np.arange(len(shape))
    edges, lengths = _edges(shape, faces)
    ends = edges.ravel()
    spacing = np.bincount(ends, np.repeat(lengths, 2), len(shape)) / np.maximum(np.bincount(ends), 1)
    widths = np.sqrt(spacing)
    lengths = lengths / widths[edges].mean(1)
    short, longest = float(np.quantile(lengths, SHORT)), STRETCH**MOST * lengths.max()
    while len(kept) > enough and short < longest:
        chosen, source = _thinned(shape[kept], faces, short * widths[kept])
        owner = np.searchsorted(chosen, source)
        corners = owner[faces]
        apart = (
            (corners[:, 0] != corners[:, 1])
            & (corners[:, 1] != corners[:, 2])
            & (corners[:, 2] != corners[:, 0])
        )
        faces = _unique(corners[apart])
        kept, nearest = kept[chosen], owner[nearest]
        short *= STRETCH
    fewer = MeshSequence(meshes.vertices[:, kept], jnp.asarray(faces, meshes.faces.dtype), meshes.rate)
    return Coarse(fewer, kept, nearest)


def enough_vertices(joints: int | None) -> int:
    """Return how many vertices show a body of so many joints between rigid parts, or of an unknown number."""
    return ENOUGH if joints is None else min(max(FOR_A_PART * (joints + 1), LEAST), ENOUGH)


def coarse_alpha(alpha: float, fine: int, coarse: int) -> float:
    """The weight of shape on a coarse mesh that counts smooth errors as `alpha` does on the fine one:
    a Laplacian grows with the square of the edges' length, its square with the fourth power."""
    return alpha * (coarse / fine) ** 2


def _thinned(
    shape: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "T 3"], short: Float[np.ndarray, "V"]
) -> tuple[Int[np.ndarray, "S"], Int[np.ndarray, "V"]]:
    """A set of vertices, to which none can be added, no two of which share an edge that is short for
    both; and for every vertex the one of the set that it is or that its shortest edge leads to."""
    edges, lengths = _edges(shape, faces)
    joined = lengths < short[edges].mean(1)
    edges, lengths = edges[joined], lengths[joined]
    both = np.concatenate([edges, edges[:, ::-1]])
    order = np.lexsort([np.tile(lengths, 2), both[:, 0]])
    ends = np.searchsorted(both[order, 0], np.arange(len(shape) + 1))
    neighbours = both[order, 1]
    is_open, source = np.ones(len(shape), bool), np.arange(len(shape))
    for vertex in range(len(shape)):
        if is_open[vertex]:
            is_open[neighbours[ends[vertex] : ends[vertex + 1]]] = False
    # an open vertex was never next to one before it
    for vertex in np.flatnonzero(~is_open):
        near = neighbours[ends[vertex] : ends[vertex + 1]]
        source[vertex] = near[is_open[near]][0]
    return np.flatnonzero(is_open), source


def _edges(
    shape: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "T 3"]
) -> tuple[Int[np.ndarray, "E 2"], Float[np.ndarray, "E"]]:
    """The edges of a mesh and their lengths."""
    edges = mesh_edges(faces)
    return edges, np.linalg.norm(shape[edges[:, 0]] - shape[edges[:, 1]], axis=1)


def _unique(faces: Int[np.ndarray, "T 3"]) -> Int[np.ndarray, "T 3"]:
    _, first = np.unique(np.sort(faces, axis=1), axis=0, return_index=True)
    return faces[np.sort(first)]
