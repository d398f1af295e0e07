"""Maps of the vertices of a surface to points on it."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from ...geometry.mesh import corners_at_vertices


class PointMap(NamedTuple):
    """For each vertex, the point of a triangle that it is mapped to: three vertices, and their weights."""

    corners: Int[np.ndarray, "V 3"]
    weights: Float[np.ndarray, "V 3"]

    def pull_back(self, values: Float[np.ndarray, "N *C"]) -> Float[np.ndarray, "V *C"]:
        """Evaluate values at the vertices, linear on triangles, at the image of each vertex."""
        return np.einsum("vc,vc...->v...", self.weights, values[self.corners])

    @property
    def nearest(self) -> Int[np.ndarray, "V"]:
        """The vertex that each image is nearest to, by the weights."""
        return np.take_along_axis(self.corners, self.weights.argmax(1)[:, None], 1)[:, 0]


def nearest_rows(
    queries: Float[np.ndarray, "Q K"], rows: Float[np.ndarray, "V K"], block: int = 1024
) -> Int[np.ndarray, "Q"]:
    """Find the nearest row of each query; a tree is slower in so many dimensions."""
    queries, rows = queries.astype(np.float32), rows.astype(np.float32)
    squares = np.sum(rows * rows, 1)
    blocks = range(0, len(queries), block)
    return np.concatenate(
        [np.argmin(squares - 2 * queries[first : first + block] @ rows.T, 1) for first in blocks]
    )


def nearest_points(
    queries: Float[np.ndarray, "Q K"], rows: Float[np.ndarray, "V K"], faces: Int[np.ndarray, "T 3"]
) -> PointMap:
    """Find the nearest point to each query on the triangles of its nearest vertex, in K dimensions."""
    vertices = nearest_rows(queries, rows)
    owners, found = corners_at_vertices(faces, vertices)
    triangles = faces[found // 3]
    weights, squares = _nearest_in_triangles(queries[owners], rows[triangles])
    best = np.lexsort([squares, owners])
    first = best[np.searchsorted(owners[best], np.arange(len(queries)))]
    return PointMap(triangles[first], weights[first])


def _nearest_in_triangles(
    points: Float[np.ndarray, "N K"], corners: Float[np.ndarray, "N 3 K"]
) -> tuple[Float[np.ndarray, "N 3"], Float[np.ndarray, "N"]]:
    """Find the nearest point of one triangle for each point: its weights, and the squared distance."""
    options = [_inside(points, corners), *(_on_side(points, corners, side) for side in range(3))]
    squares = np.stack(
        [np.sum((points - np.einsum("nc,nck->nk", option, corners)) ** 2, 1) for option in options]
    )
    best, rows = np.argmin(squares, 0), np.arange(len(points))
    return np.stack(options)[best, rows], squares[best, rows]


def _on_side(points: np.ndarray, corners: np.ndarray, side: int) -> Float[np.ndarray, "N 3"]:
    """Project points onto one side of each triangle."""
    a, b = side, (side + 1) % 3
    along = corners[:, b] - corners[:, a]
    share = np.sum((points - corners[:, a]) * along, 1) / np.maximum(np.sum(along * along, 1), 1e-300)
    weights = np.zeros((len(points), 3))
    weights[:, b] = np.clip(share, 0.0, 1.0)
    weights[:, a] = 1 - weights[:, b]
    return weights


def _inside(points: np.ndarray, corners: np.ndarray) -> Float[np.ndarray, "N 3"]:
    """Project points onto the planes of triangles; the first corner replaces a projection outside of its triangle."""
    first, second, away = (other - corners[:, 0] for other in (corners[:, 1], corners[:, 2], points))
    aa, bb, ab = (np.sum(a * b, 1) for a, b in ((first, first), (second, second), (first, second)))
    ap, bp = np.sum(first * away, 1), np.sum(second * away, 1)
    scale = np.maximum(aa * bb - ab**2, 1e-300)
    u, v = (bb * ap - ab * bp) / scale, (aa * bp - ab * ap) / scale
    weights = np.stack([1 - u - v, u, v], 1)
    inside = np.asarray(np.min(weights, 1) >= 0)
    return np.where(inside[:, None], weights, [1.0, 0.0, 0.0])
