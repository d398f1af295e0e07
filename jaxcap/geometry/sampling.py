"""Spatial sorting of points, evenly spread indices, farthest point sampling, and connected groups of points."""

import numpy as np
from jaxtyping import Array, Bool, Float, Int
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree


def spatial_order(points: Float[Array | np.ndarray, "N 3"], weights=None) -> np.ndarray:
    """Compute an order `(N,)` of points along a Morton curve, so that neighbours in space are near in
    memory.

    Points whose `weights (N,)` are zero come last. In NumPy, once for each cloud.
    """
    points = np.asarray(points, float)
    real = np.ones(len(points), bool) if weights is None else np.asarray(weights) > 0
    if not real.any():
        return np.arange(len(points))
    low, high = points[real].min(0), points[real].max(0)
    scaled = np.clip((points - low) / max((high - low).max(), 1e-12), 0.0, 1.0)
    cells = np.where(real[:, None], scaled * 1023, 0.0).astype(np.int64)
    key = np.zeros(len(points), np.int64)
    for bit in range(10):
        for axis in range(3):
            key |= ((cells[:, axis] >> bit) & 1) << (3 * bit + axis)
    return np.lexsort((key, ~real))


def even_indices(
    count: int | np.integer, limit: int | np.integer, nearest: bool = False
) -> Int[np.ndarray, "K"]:
    """Spread at most `limit` of the indices 0 to `count - 1` evenly, first and last included, in ascending order.

    Indices between two integers are rounded down, or to the `nearest` one.
    """
    steps = np.linspace(0, count - 1, min(count, limit))
    return (steps.round() if nearest else steps).astype(int)


def farthest_points(
    features: Float[np.ndarray, "N C"], count: int, first: int, excluded: Bool[np.ndarray, "N"] | None = None
) -> Int[np.ndarray, "K"]:
    """Sample at most `count` points by farthest point sampling (Gonzalez 1985), as ascending indices.

    The sample starts with the point `first`. It has neither `excluded` points nor two that coincide.
    """
    chosen, distances = [first], np.sum((features - features[first]) ** 2, 1)
    if excluded is not None:
        distances[excluded] = 0.0
    while len(chosen) < count and distances.max() > 0:
        chosen.append(int(np.argmax(distances)))
        distances = np.minimum(distances, np.sum((features - features[chosen[-1]]) ** 2, 1))
    return np.sort(chosen)


def connected_labels(points: Float[np.ndarray, "N 3"], link_length: float) -> Int[np.ndarray, "N"]:
    """Label connected components of points.

    Cells have a side of half a `link_length`, metres. Occupied cells are connected if their distance is at most two
    sides.
    """
    cells, cell_of = np.unique(np.floor(points / (link_length / 2)).astype(int), axis=0, return_inverse=True)
    pairs = KDTree(cells).query_pairs(2.0, output_type="ndarray")
    graph = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(len(cells), len(cells)))
    return connected_components(graph, directed=False)[1][cell_of.reshape(-1)]
