"""Groups of points that are connected in space."""

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree


def connected_labels(points: Float[np.ndarray, "N 3"], link_length: float) -> Int[np.ndarray, "N"]:
    """Label connected components of points.

    Cells have a side of half a `link_length`, metres. Occupied cells are connected if their distance is at most two
    sides.
    """
    cells, cell_of = np.unique(np.floor(points / (link_length / 2)).astype(int), axis=0, return_inverse=True)
    pairs = KDTree(cells).query_pairs(2.0, output_type="ndarray")
    graph = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(len(cells), len(cells)))
    return connected_components(graph, directed=False)[1][cell_of.reshape(-1)]
