"""Costs of joints under which the tree of a symmetric surface is symmetric."""

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import coo_array
from scipy.sparse.csgraph import breadth_first_order

from ...geometry.spanning_tree import spanning_tree


def symmetric_joint_costs(
    costs: Float[np.ndarray, "P"],
    pairs: Int[np.ndarray, "P 2"],
    partners: Int[np.ndarray, "K"],
    areas: Float[np.ndarray, "K"],
) -> Float[np.ndarray, "P"]:
    """Make joints free of cost that form a symmetric tree, and all others more expensive than these.

    Parts that mirror each other are one node. The spanning tree of these nodes, with mean costs, is followed from the largest
    part on the middle: joints below it come in pairs, except that a part on the middle whose parent is one of a pair has one
    joint, as a part has one parent.

    **Arguments:** costs of possible joints between `pairs` of parts; the part that mirrors each, itself on the middle and -1 if
    there is none; areas of the parts.
    """
    count = len(partners)
    rows = np.arange(count)
    nodes, node = np.unique(np.where(partners < 0, rows, np.minimum(rows, partners)), return_inverse=True)
    ends = np.sort(node[pairs], axis=1)
    proper = np.flatnonzero(ends[:, 0] != ends[:, 1])
    edges, group = np.unique(ends[proper], axis=0, return_inverse=True)
    group = group.reshape(-1)
    means = np.bincount(group, costs[proper], len(edges)) / np.bincount(group, minlength=len(edges))
    tree = edges[spanning_tree(means, edges, len(nodes))]
    single = np.bincount(node, minlength=len(nodes)) == 1
    sizes = np.where(single, np.bincount(node, areas, len(nodes)), 0.0)
    above = _parents(tree, len(nodes), int(np.argmax(sizes)))
    chosen = np.zeros(len(costs), bool)
    for child, parent in enumerate(above.tolist()):
        own = proper[(edges[group] == sorted((child, parent))).all(1)] if parent >= 0 else proper[:0]
        # each part of the child has one joint, the cheapest
        inner = np.where(node[pairs[own, 0]] == child, pairs[own, 0], pairs[own, 1])
        order = own[np.lexsort([costs[own], inner])]
        first = np.unique(np.sort(inner), return_index=True)[1]
        chosen[order[first]] = True
    return np.where(chosen, 0.0, costs + costs.sum())


def _parents(tree: Int[np.ndarray, "E 2"], count: int, root: int) -> Int[np.ndarray, "N"]:
    """Return the parent of each node of a tree, and -1 at its root."""
    graph = coo_array((np.ones(len(tree)), (tree[:, 0], tree[:, 1])), shape=(count, count)).tocsr()
    above = breadth_first_order(graph, root, directed=False)[1]
    return np.where(np.arange(count) == root, -1, above)
