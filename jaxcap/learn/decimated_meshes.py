"""Decimation of a mesh sequence. Learning begins on fewer vertices, at a fraction of the cost."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from ..geometry.mesh import mesh_edges
from ..observe.meshes import MeshSequence

#: the most vertices of a decimated mesh; the number for each part where the number of parts is known; the
#: least such bound
MAX_VERTICES, VERTICES_PER_PART, MIN_VERTICES = 4000, 105, 1000
#: the share of edges that are short at first, the factor by which the threshold grows, and the limit beyond
#: the longest edge as a power of that factor
SHORT, STRETCH, MAX_GROWTH_POWER = 0.1, 1.25, 8


class DecimatedMeshes(NamedTuple):
    """A subset of the vertices of a mesh sequence, with triangles between their neighbourhoods."""

    meshes: MeshSequence
    #: (S,) indices of the kept vertices
    kept: Int[np.ndarray, "S"]
    #: (V,) for each vertex, the position in `kept` of the nearest kept vertex
    nearest: Int[np.ndarray, "V"]


def decimate_meshes(meshes: MeshSequence, max_vertices: int = MAX_VERTICES) -> DecimatedMeshes:
    """Decimate meshes by merging vertices along short edges until at most `max_vertices` vertices are left.

    No two kept vertices share a short edge; the threshold for short grows in steps. Vertices keep their
    positions, so that a body learned from them is also valid on the whole mesh. Edge lengths are divided by
    the square root of the original vertex spacing. Dense regions such as a face are therefore decimated
    first, but hands stay denser than the trunk, as their bones are smaller. Small meshes are returned
    unchanged.
    """
    faces, shape = np.asarray(meshes.faces), np.asarray(meshes.vertices[0], float)
    kept = nearest = np.arange(len(shape))
    edges, lengths = _edges(shape, faces)
    ends = edges.ravel()
    spacing = np.bincount(ends, np.repeat(lengths, 2), len(shape)) / np.maximum(np.bincount(ends), 1)
    widths = np.sqrt(spacing)
    lengths = lengths / widths[edges].mean(1)
    short, longest = float(np.quantile(lengths, SHORT)), STRETCH**MAX_GROWTH_POWER * lengths.max()
    while len(kept) > max_vertices and short < longest:
        chosen, source = _thinned(shape[kept], faces, short * widths[kept])
        owner = np.searchsorted(chosen, source)
        corners = owner[faces]
        proper = (
            (corners[:, 0] != corners[:, 1])
            & (corners[:, 1] != corners[:, 2])
            & (corners[:, 2] != corners[:, 0])
        )
        faces = _unique(corners[proper])
        kept, nearest = kept[chosen], owner[nearest]
        short *= STRETCH
    fewer = MeshSequence(meshes.vertices[:, kept], jnp.asarray(faces, meshes.faces.dtype), meshes.rate)
    return DecimatedMeshes(fewer, kept, nearest)


def num_coarse_vertices(joints: int | None) -> int:
    """Return the number of vertices sufficient for a body with this number of joints, or with an unknown
    number."""
    return (
        MAX_VERTICES
        if joints is None
        else min(max(VERTICES_PER_PART * (joints + 1), MIN_VERTICES), MAX_VERTICES)
    )


def coarse_alpha(alpha: float, fine: int, coarse: int) -> float:
    """Scale the weight of the Laplacian term so that smooth errors count on the coarse mesh as on the fine
    one.

    A Laplacian grows with the square of the edge length, and its square with the fourth power.
    """
    return alpha * (coarse / fine) ** 2


def _thinned(
    shape: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "T 3"], short: Float[np.ndarray, "V"]
) -> tuple[Int[np.ndarray, "S"], Int[np.ndarray, "V"]]:
    """Select a maximal set of vertices in which no two share an edge that is short for both.

    Also returns, for each vertex, itself if it is selected, or else the selected neighbour along its shortest
    edge.
    """
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
    # the set is maximal: every vertex outside it has a selected neighbour
    for vertex in np.flatnonzero(~is_open):
        near = neighbours[ends[vertex] : ends[vertex + 1]]
        source[vertex] = near[is_open[near]][0]
    return np.flatnonzero(is_open), source


def _edges(
    shape: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "T 3"]
) -> tuple[Int[np.ndarray, "E 2"], Float[np.ndarray, "E"]]:
    """Return the edges of a mesh and their lengths."""
    edges = mesh_edges(faces)
    return edges, np.linalg.norm(shape[edges[:, 0]] - shape[edges[:, 1]], axis=1)


def _unique(faces: Int[np.ndarray, "T 3"]) -> Int[np.ndarray, "T 3"]:
    _, first = np.unique(np.sort(faces, axis=1), axis=0, return_index=True)
    return faces[np.sort(first)]
