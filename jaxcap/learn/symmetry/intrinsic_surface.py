"""A surface by the lengths of its edges alone: mean lengths over meshes, the Laplacian, areas, and geodesic distances."""

from typing import NamedTuple

import numpy as np
import scipy.sparse
from jaxtyping import Float, Int
from scipy.sparse.csgraph import dijkstra

from ...geometry.laplacian import cotangent_laplacian
from ...geometry.mesh import triangle_sides, vertex_areas
from ...geometry.sampling import even_indices

#: the most meshes whose edge lengths are averaged
FRAMES = 32


class IntrinsicSurface(NamedTuple):
    """A triangle mesh with edge lengths that are means over several poses.

    A pose stretches and bends the skin around joints on one side and not on the other. Means over poses are closer to a
    symmetric surface. The mean of lengths that satisfy the triangle inequality satisfies it, too.
    """

    faces: Int[np.ndarray, "T 3"]
    #: corners of each triangle, flattened into a plane, metres
    flat: Float[np.ndarray, "T 3 3"]
    num_vertices: int
    #: `(V, V)` lengths of edges, and of straight lines across two neighbouring triangles, metres
    paths: scipy.sparse.csr_matrix

    @property
    def areas(self) -> Float[np.ndarray, "V"]:
        """A third of the area of the triangles of each vertex, square metres."""
        corners = vertex_areas(self.flat.reshape(-1, 3), _separate_corners(self.faces))
        return np.bincount(self.faces.ravel(), corners, self.num_vertices)

    @property
    def corner_matrix(self) -> scipy.sparse.csr_array:
        """The `(V, T)` matrix that sums values of triangles at their vertices."""
        columns = np.repeat(np.arange(len(self.faces)), 3)
        shape = (self.num_vertices, len(self.faces))
        return scipy.sparse.csr_array((np.ones(len(columns)), (self.faces.ravel(), columns)), shape=shape)

    @property
    def laplacian(self) -> scipy.sparse.csr_array:
        """The cotangent Laplacian `(V, V)`, positive semidefinite."""
        separate = cotangent_laplacian(self.flat.reshape(-1, 3), _separate_corners(self.faces))
        rows = np.arange(self.faces.size)
        shape = (self.faces.size, self.num_vertices)
        joined = scipy.sparse.csr_array((np.ones(len(rows)), (rows, self.faces.ravel())), shape=shape)
        return (joined.T @ separate @ joined).tocsr()


def make_intrinsic_surface(
    shapes: Float[np.ndarray, "F V 3"], faces: Int[np.ndarray, "T 3"]
) -> IntrinsicSurface:
    """Average the edge lengths of at most `FRAMES` meshes, and flatten every triangle into a plane."""
    chosen = shapes[even_indices(len(shapes), FRAMES, nearest=True)].astype(float)
    corners = chosen[:, faces]
    ab, bc, ca = (
        np.linalg.norm(corners[:, :, (side + 1) % 3] - corners[:, :, side], axis=-1).mean(0)
        for side in range(3)
    )
    ab = np.maximum(ab, 1e-9 * ab.max())
    along = (ab**2 + ca**2 - bc**2) / (2 * ab)
    across = np.sqrt(np.maximum(ca**2 - along**2, 0.0))
    none = np.zeros_like(ab)
    flat = np.stack([none, none, none, ab, none, none, along, across, none], 1).reshape(-1, 3, 3)
    return IntrinsicSurface(faces, flat, shapes.shape[1], _path_graph(faces, flat, shapes.shape[1]))


def geodesic_distances(surface: IntrinsicSurface, sources: Int[np.ndarray, "S"]) -> Float[np.ndarray, "S V"]:
    """Compute the lengths of shortest paths from some vertices to all, metres; infinite between components.

    Paths follow edges, and straight lines across two neighbouring triangles. Along edges alone, distances depend on the
    directions of the edges by up to 15 %.
    """
    return dijkstra(surface.paths, directed=False, indices=sources)


def _path_graph(
    faces: Int[np.ndarray, "T 3"], flat: Float[np.ndarray, "T 3 3"], num_vertices: int
) -> scipy.sparse.csr_matrix:
    """Build the graph of the path segments, each pair of vertices once, with its shortest segment."""
    pairs, lengths = _path_segments(faces, flat)
    # duplicates would be added up
    first, second = np.sort(pairs, axis=1).T
    order = np.lexsort([lengths, second, first])
    keys = first[order] * num_vertices + second[order]
    kept = order[np.concatenate([[True], keys[1:] != keys[:-1]])]
    shape = (num_vertices, num_vertices)
    return scipy.sparse.csr_matrix((lengths[kept], (first[kept], second[kept])), shape=shape)


def _path_segments(
    faces: Int[np.ndarray, "T 3"], flat: Float[np.ndarray, "T 3 3"]
) -> tuple[Int[np.ndarray, "N 2"], Float[np.ndarray, "N"]]:
    """List the edges, and the straight lines across two neighbouring triangles, with their lengths."""
    count = len(faces)
    sides = triangle_sides(faces)
    starts, ends = (np.concatenate([flat[:, (side + turn) % 3, :2] for side in range(3)]) for turn in (0, 1))
    tips = np.concatenate([flat[:, (side + 2) % 3, :2] for side in range(3)])
    opposite = np.concatenate([faces[:, (side + 2) % 3] for side in range(3)])
    lengths = np.maximum(np.linalg.norm(ends - starts, axis=1), 1e-12)
    directions = (ends - starts) / lengths[:, None]
    along = np.sum((tips - starts) * directions, 1)
    heights = np.sqrt(np.maximum(np.sum((tips - starts) ** 2, 1) - along**2, 0.0))
    # positions along the side are measured from its smaller vertex
    along = np.where(sides[:, 0] < sides[:, 1], along, lengths - along)
    ordered = np.sort(sides, axis=1)
    order = np.lexsort([np.tile(np.arange(count), 3), ordered[:, 1], ordered[:, 0]])
    alike = (ordered[order][1:] == ordered[order][:-1]).all(1)
    a, b = order[:-1][alike], order[1:][alike]
    # the line crosses the side between its ends
    total = np.maximum(heights[a] + heights[b], 1e-12)
    crossing = (along[a] * heights[b] + along[b] * heights[a]) / total
    straight = (crossing > 0) & (crossing < lengths[a]) & (opposite[a] != opposite[b])
    a, b = a[straight], b[straight]
    across = np.hypot(along[a] - along[b], heights[a] + heights[b])
    pairs = np.concatenate([sides, np.stack([opposite[a], opposite[b]], 1)])
    return pairs, np.concatenate([lengths, across])


def _separate_corners(faces: Int[np.ndarray, "T 3"]) -> Int[np.ndarray, "T 3"]:
    """Number the corners of all triangles."""
    return np.arange(faces.size).reshape(-1, 3)
