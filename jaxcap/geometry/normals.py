"""Normal estimation for point clouds."""

import numpy as np
from jaxtyping import Float
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import breadth_first_order, connected_components, minimum_spanning_tree
from scipy.spatial import KDTree


def estimate_normals(points: Float[np.ndarray, "N 3"], neighbours: int = 12) -> Float[np.ndarray, "N 3"]:
    """Estimate unit normals from local planes, oriented outwards.

    A normal is the direction of least variance of a point's neighbours (PCA). Signs are propagated along a
    minimum spanning tree of the neighbourhood graph, between the most parallel planes (Hoppe et al. 1992).
    Each connected component is flipped so that its normals point away from its mean on average. A normal is
    zero, which means unknown, in clouds of fewer than four points and where neighbours have no plane.
    """
    points = np.asarray(points, float)
    count = min(neighbours + 1, len(points))
    if count < 4:
        return np.zeros_like(points)
    near = np.asarray(KDTree(points).query(points, count)[1])
    patches = points[near] - points[near].mean(1, keepdims=True)
    values, vectors = np.linalg.eigh(np.einsum("nka,nkb->nab", patches, patches))
    normals = vectors[:, :, 0]
    # collinear or coincident points have no plane
    flat = values[:, 1] > 1e-9 * np.maximum(values[:, 2], 1e-30)
    rows = np.repeat(np.arange(len(points)), count - 1)
    columns = near[:, 1:].reshape(-1)
    unlike = 1.0 + 1e-6 - np.abs(np.sum(normals[rows] * normals[columns], 1))
    graph = coo_matrix((unlike, (rows, columns)), shape=(len(points),) * 2).tocsr()
    tree = minimum_spanning_tree(graph.maximum(graph.T))
    tree = tree + tree.T
    pieces, label = connected_components(tree, directed=False)
    for piece in range(pieces):
        members = np.flatnonzero(label == piece)
        order, parents = breadth_first_order(tree, members[0], directed=False)
        for point in order[1:]:
            if normals[point] @ normals[parents[point]] < 0:
                normals[point] *= -1
        outwards = points[members] - points[members].mean(0)
        if np.sum(outwards * normals[members]) < 0:
            normals[members] *= -1
    return np.where(flat[:, None], normals, 0.0)
