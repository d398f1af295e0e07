"""Minimum spanning trees."""

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import coo_array
from scipy.sparse.csgraph import minimum_spanning_tree


def spanning_tree(
    costs: Float[np.ndarray, "N"], pairs: Int[np.ndarray, "N 2"], count: int
) -> Int[np.ndarray, "T"]:
    """Find the minimum spanning tree, or forest, of a graph with `count` nodes and an edge for each pair.

    Returns the indices of the tree's edges, in ascending order of cost. Of edges with equal costs the first
    is preferred.
    """
    order = np.argsort(np.asarray(costs), kind="stable")
    ends = np.sort(np.asarray(pairs).reshape(-1, 2)[order], axis=1)
    # of several edges between two nodes only the cheapest counts; ranks are unique and not zero
    _, first = np.unique(ends, axis=0, return_index=True)
    graph = coo_array((first + 1.0, tuple(ends[first].T)), shape=(count, count))
    ranks = np.sort(minimum_spanning_tree(graph.tocsr()).data.astype(int)) - 1
    return order[ranks]
