"""The connected graph of a mesh's vertices, and sets of vertices on it."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy import sparse
from scipy.sparse.csgraph import connected_components, dijkstra

from ...geometry.mesh import mesh_edges, vertex_areas
from ...geometry.sampling import even_indices, farthest_points

#: frames used to measure distances between pieces of a mesh
BRIDGE_FRAMES = 16
#: vertices sampled from a large piece to join it to others
BRIDGE_SAMPLES = 64
#: rounds of Lloyd's algorithm for the seeds of patches
LLOYD_ROUNDS = 4


class SurfaceGraph(NamedTuple):
    """A connected graph over the vertices of a mesh, with vertex areas.

    Edges are those of the triangles, edges between vertices that coincide in every frame, and, between pieces
    that are still disconnected, an edge between their closest vertices.
    """

    #: (E, 2), first less than second
    edges: Int[np.ndarray, "E 2"]
    #: metres in the rest mesh
    lengths: Float[np.ndarray, "E"]
    #: share of each vertex in the surface area, positive, with sum one
    areas: Float[np.ndarray, "V"]
    #: (E,) false for edges that only connect pieces
    is_mesh_edge: np.ndarray


def make_surface_graph(
    rest: Float[np.ndarray, "V 3"], meshes: Float[np.ndarray, "F V 3"], faces: Int[np.ndarray, "T 3"]
) -> SurfaceGraph:
    """Build the graph of a mesh with vertices `rest` at rest and `meshes` over time."""
    count = len(rest)
    edges = mesh_edges(faces)
    chosen = even_indices(len(meshes), BRIDGE_FRAMES, nearest=True)
    positions = meshes[chosen].transpose(1, 0, 2).reshape(count, -1).astype(float) / np.sqrt(len(chosen))
    edges = np.concatenate([edges, _coincident(positions)])
    bridges = _bridges(positions, edges)
    real = np.arange(len(edges) + len(bridges)) < len(edges)
    edges = np.concatenate([edges, bridges])
    lengths = np.linalg.norm(rest[edges[:, 0]] - rest[edges[:, 1]], axis=1)
    return SurfaceGraph(edges, lengths, _areas(rest, faces), real)


def adjacency(surface: SurfaceGraph, values: np.ndarray | None = None) -> sparse.csr_matrix:
    """Build the symmetric adjacency matrix of the graph, with ones by default."""
    values = np.ones(len(surface.edges)) if values is None else values
    count = len(surface.areas)
    first, second = surface.edges.T
    half = sparse.csr_matrix((values, (first, second)), shape=(count, count))
    return half + half.T


def membership(
    labels: Int[np.ndarray, "V"], weights: Float[np.ndarray, "V"], count: int
) -> sparse.csr_matrix:
    """Build the (S, V) matrix of vertex weights by set; vertices with negative labels are ignored."""
    labelled = np.flatnonzero(labels >= 0)
    return sparse.csr_matrix((weights[labelled], (labels[labelled], labelled)), shape=(count, len(labels)))


def cut_patches(
    surface: SurfaceGraph, rest: Float[np.ndarray, "V 3"], count: int, subset: np.ndarray | None = None
) -> Int[np.ndarray, "V"]:
    """Partition a surface into at most `count` connected patches of about equal width.

    Patches are geodesic Voronoi cells of seeds from farthest point sampling, moved by Lloyd's algorithm. With
    `subset`, a connected set of vertices, only that set is partitioned; other vertices have the label -1.
    """
    vertices = np.arange(len(rest)) if subset is None else np.asarray(subset)
    points, areas = rest[vertices], surface.areas[vertices]
    # a sparse matrix treats zero as no edge
    graph = adjacency(surface, np.maximum(surface.lengths, 1e-9 * np.ptp(rest, axis=0).max()))
    graph = graph[vertices][:, vertices]
    outermost = int(np.argmax(np.sum((points - points.mean(0)) ** 2, 1)))
    seeds = farthest_points(points, count, outermost)
    cells = np.zeros(len(points), int)
    for _ in range(LLOYD_ROUNDS):
        _, _, nearest = dijkstra(graph, indices=seeds, min_only=True, return_predecessors=True)
        cells = np.searchsorted(seeds, nearest)
        groups = membership(cells, areas, len(seeds))
        middles = (groups @ points) / np.asarray(groups.sum(1))
        gaps = np.linalg.norm(points - middles[cells], axis=1)
        order = np.lexsort([gaps, cells])
        seeds = np.unique(order[np.searchsorted(cells[order], np.unique(cells))])
    _, _, nearest = dijkstra(graph, indices=seeds, min_only=True, return_predecessors=True)
    labels = np.full(len(rest), -1)
    labels[vertices] = np.searchsorted(seeds, nearest)
    return labels


def boundary_edges(
    surface: SurfaceGraph, labels: Int[np.ndarray, "V"]
) -> tuple[Int[np.ndarray, "B 2"], Int[np.ndarray, "B"]]:
    """Return the graph edges between two sets: pairs of labels, the lesser first, and the edge indices."""
    pairs = labels[surface.edges]
    crossing = np.flatnonzero((pairs[:, 0] != pairs[:, 1]) & (pairs >= 0).all(1))
    return np.sort(pairs[crossing], axis=1), crossing


def make_connected(
    surface: SurfaceGraph, labels: Int[np.ndarray, "V"], costs: Float[np.ndarray, "V K"]
) -> Int[np.ndarray, "V"]:
    """Make sets connected: each keeps its largest piece, and other vertices go to the neighbouring set of
    least cost."""
    same = labels[surface.edges[:, 0]] == labels[surface.edges[:, 1]]
    inside = adjacency(surface, same.astype(float))
    inside.eliminate_zeros()
    number, pieces = connected_components(inside, directed=False)
    areas = np.bincount(pieces, surface.areas, number)
    owner = np.zeros(number, int)
    owner[pieces] = labels
    order = np.lexsort([-areas, owner])
    first = np.ones(number, bool)
    first[1:] = owner[order][1:] != owner[order][:-1]
    labels = np.where(np.isin(pieces, order[first]), labels, -1)
    both = np.concatenate([surface.edges, surface.edges[:, ::-1]])
    while (labels < 0).any():
        open_, labelled = both[(labels[both[:, 0]] < 0) & (labels[both[:, 1]] >= 0)].T
        offered = labels[labelled]
        order = np.lexsort([costs[open_, offered], open_])
        vertex, place = np.unique(open_[order], return_index=True)
        labels[vertex] = offered[order][place]
    return labels


def _areas(rest: np.ndarray, faces: np.ndarray) -> np.ndarray:
    areas = vertex_areas(rest, faces)
    total = areas.sum()
    # vertices without triangles also belong to a part
    areas = areas / total if total > 0 else areas
    areas = np.maximum(areas, 1e-3 / len(rest))
    return areas / areas.sum()


def _coincident(positions: np.ndarray) -> np.ndarray:
    """Find edges between vertices that coincide in every frame."""
    _, inverse = np.unique(positions, axis=0, return_inverse=True)
    order = np.argsort(inverse, kind="stable")
    alike = inverse[order][1:] == inverse[order][:-1]
    return np.stack([order[:-1][alike], order[1:][alike]], 1)


def _bridges(positions: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """Find the shortest edges over all frames that connect all pieces (Borůvka's algorithm)."""
    count = len(positions)
    found = [np.zeros((0, 2), int)]
    squares = np.sum(positions * positions, 1)
    while True:
        joined = np.concatenate([edges, *found])
        graph = sparse.coo_matrix((np.ones(len(joined)), tuple(joined.T)), shape=(count, count))
        number, pieces = connected_components(graph, directed=False)
        if number == 1:
            return np.concatenate(found)
        largest = int(np.argmax(np.bincount(pieces)))
        links = []
        for piece in range(number):
            if piece == largest:
                continue
            members = np.flatnonzero(pieces == piece)
            members = members[even_indices(len(members), BRIDGE_SAMPLES)]
            gaps = squares[members, None] + squares - 2 * positions[members] @ positions.T
            gaps[:, pieces == piece] = np.inf
            best = np.unravel_index(np.argmin(gaps), gaps.shape)
            links.append(sorted((int(members[best[0]]), int(best[1]))))
        found.append(np.unique(np.array(links), axis=0))
