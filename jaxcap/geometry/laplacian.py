"""The uniform Laplacian of a mesh, and the conformance metric of learned surfaces.

A field of errors `e (V, 3)` over a mesh is measured by

    |e|^2 + alpha |L e|^2 = sum e . A e,    A = I + alpha L^T L

with `L` the uniform Laplacian (Adaptation, eqs. 3.19 and 3.20). Errors that neighbours share have a low
cost, differences between neighbours a high cost. Fields of many columns have their Laplacian by patches of
the mesh.
"""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import scipy.sparse
from jaxtyping import Array, Float, Int

from .mesh import area_normals, mesh_edges


class Conformance(eqx.Module):
    """The metric `A = I + alpha L^T L` over the vertices of a mesh."""

    #: neighbours of each vertex, padded with the vertex itself
    neighbours: Int[Array, "V N"]
    #: one over the number of neighbours; zero where a vertex has none
    inverse_degrees: Float[Array, "V"]
    #: the diagonal of A
    diagonal: Float[Array, "V"]
    alpha: Float[Array, ""]


def make_conformance(faces: Int[np.ndarray, "F 3"], num_vertices: int, alpha: float) -> Conformance:
    """Create the metric of a triangle mesh; `alpha >= 0` weighs shape against distance.

    **Raises:** `ValueError` for a negative or infinite `alpha`.
    """
    if not 0 <= alpha < np.inf:
        raise ValueError(
            f"`alpha`, the weight of shape relative to distance, is {alpha}; expected a finite number of at least 0."
        )
    adjacency = vertex_adjacency(faces, num_vertices)
    counts = np.diff(adjacency.indptr)
    width = max(int(counts.max(initial=0)), 1)
    neighbours = np.tile(np.arange(num_vertices)[:, None], (1, width))
    rows = np.repeat(np.arange(num_vertices), counts)
    neighbours[rows, np.arange(len(rows)) - adjacency.indptr[rows]] = adjacency.indices
    shares = np.where(counts > 0, 1.0 / np.maximum(counts, 1), 0.0)
    laplacian = laplacian_matrix(adjacency)
    squares = np.asarray(laplacian.multiply(laplacian).sum(0)).ravel()
    return Conformance(
        jnp.asarray(neighbours),
        jnp.asarray(shares),
        jnp.asarray(1.0 + alpha * squares),
        jnp.asarray(float(alpha)),
    )


def laplacian(metric: Conformance, field: Float[Array, "V C"]) -> Float[Array, "V C"]:
    """Compute `L e`: the difference of each vertex's value from the mean of its neighbours (eq. 3.20)."""
    width = metric.neighbours.shape[1]
    # a padded slot has the vertex itself, and adds nothing to the sum of differences
    total = sum(field[metric.neighbours[:, i]] for i in range(width))
    return metric.inverse_degrees[:, None] * (width * field - total)


def adjoint(metric: Conformance, field: Float[Array, "V C"]) -> Float[Array, "V C"]:
    """Compute `L^T e` by gathering, as the adjacency is symmetric."""
    width = metric.neighbours.shape[1]
    weighted = metric.inverse_degrees[:, None] * field
    total = sum(weighted[metric.neighbours[:, i]] for i in range(width))
    # sum over real neighbours of (own weighted value - the neighbour's); the padding cancels
    real = jnp.sum(metric.neighbours != jnp.arange(len(metric.neighbours))[:, None], 1)[:, None]
    return real * weighted - (total - (width - real) * weighted)


def apply_conformance(metric: Conformance, field: Float[Array, "V C"]) -> Float[Array, "V C"]:
    """Compute `A e`, half the gradient of `energy`."""
    return field + metric.alpha * adjoint(metric, laplacian(metric, field))


def energy(metric: Conformance, field: Float[Array, "V C"]) -> Float[Array, ""]:
    """Compute `e . A e` (Adaptation, eq. 3.19), in squared metres."""
    return jnp.sum(field**2) + metric.alpha * jnp.sum(laplacian(metric, field) ** 2)


def matrix(metric: Conformance) -> scipy.sparse.csr_array:
    """Assemble `A (V, V)` as a sparse matrix."""
    count = len(metric.neighbours)
    operator = laplacian_matrix(_adjacency(neighbour_pairs(metric), count))
    identity = scipy.sparse.eye_array(count, format="csr")
    return (identity + float(metric.alpha) * (operator.T @ operator)).tocsr()


def neighbour_pairs(metric: Conformance) -> Int[np.ndarray, "E 2"]:
    """List every vertex with each of its neighbours, so that each edge appears in both directions."""
    neighbours = np.asarray(metric.neighbours)
    pairs = np.stack([np.repeat(np.arange(len(neighbours)), neighbours.shape[1]), neighbours.ravel()], 1)
    return pairs[pairs[:, 0] != pairs[:, 1]]


def vertex_adjacency(faces: Int[np.ndarray, "F 3"], num_vertices: int) -> scipy.sparse.csr_array:
    """Assemble the `(V, V)` adjacency matrix: one where two vertices share an edge."""
    edges = mesh_edges(faces)
    return _adjacency(np.concatenate([edges, edges[:, ::-1]]), num_vertices)


def _adjacency(edges: Int[np.ndarray, "E 2"], num_vertices: int) -> scipy.sparse.csr_array:
    """Assemble a matrix of ones at the given pairs, each of which is given in both directions."""
    shape = (num_vertices, num_vertices)
    adjacency = scipy.sparse.csr_array((np.ones(len(edges)), (edges[:, 0], edges[:, 1])), shape=shape)
    adjacency.sort_indices()
    return adjacency


def laplacian_matrix(adjacency: scipy.sparse.csr_array) -> scipy.sparse.csr_array:
    """Assemble the uniform Laplacian `L` (eq. 3.20), `(V, V)`, from a `vertex_adjacency`; zero for a vertex
    without neighbours."""
    counts = np.asarray(adjacency.sum(1)).ravel()
    inverse = np.where(counts > 0, 1.0 / np.maximum(counts, 1), 0.0)
    inside = scipy.sparse.diags_array((counts > 0).astype(float))
    return (inside - scipy.sparse.diags_array(inverse) @ adjacency).tocsr()


def cotangent_laplacian(
    vertices: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"]
) -> scipy.sparse.csr_array:
    """Assemble the cotangent Laplacian `(V, V)`, the stiffness matrix of linear elements; positive semidefinite.

    Obtuse and degenerate triangles would make weights negative or infinite. Cotangents are therefore clipped
    to 0.001 to 10.
    """
    count = len(vertices)
    corners = vertices[faces]
    doubled = np.linalg.norm(area_normals(corners), axis=1)
    weights = scipy.sparse.csr_array((count, count))
    for i in range(3):
        a, b = (corners[:, (i + k) % 3] - corners[:, i] for k in (1, 2))
        cotangent = np.clip(np.sum(a * b, axis=1) / np.maximum(doubled, 1e-20), 1e-3, 10.0)
        first, second = faces[:, (i + 1) % 3], faces[:, (i + 2) % 3]
        weights += scipy.sparse.csr_array((0.5 * cotangent, (first, second)), shape=(count, count))
    weights = weights + weights.T
    return (scipy.sparse.diags_array(np.asarray(weights.sum(1)).ravel()) - weights).tocsr()


class PatchLaplacian(eqx.Module):
    """The Laplacian of some vertices as small dense matrices, one for each patch of the mesh.

    It is efficient for fields of many columns. A product with patches reads every row little more than
    once, a sum over neighbours once for each neighbour.
    """

    #: the vertices that each patch reads, padded with arbitrary ones
    columns: Int[Array, "B H"]
    #: `L` from these to the patch's own rows; rows beyond the patch are zero
    matrices: Float[Array, "B R H"]


def make_patch_laplacian(
    metric: Conformance, vertices: Int[np.ndarray, "S"], size: int = 32
) -> PatchLaplacian:
    """Partition the given vertices into patches of about `size`, grown over neighbours."""
    neighbours, shares = np.asarray(metric.neighbours), np.asarray(metric.inverse_degrees)
    patches = _grow_patches(neighbours, np.asarray(vertices), size)
    reads = [np.unique(neighbours[patch]) for patch in patches]
    reads = [np.union1d(read, patch) for read, patch in zip(reads, patches, strict=True)]
    # widths in multiples of 16, so that meshes of similar size compile once
    width = -16 * (-max(len(read) for read in reads) // 16)
    columns = np.zeros((len(patches), width), int)
    matrices = np.zeros((len(patches), size, width))
    for number, (patch, read) in enumerate(zip(patches, reads, strict=True)):
        columns[number, : len(read)] = read
        own = np.searchsorted(read, patch)
        around = np.searchsorted(read, neighbours[patch])
        rows = np.arange(len(patch))
        # a padded slot has the vertex itself, and cancels
        np.add.at(matrices[number], (rows[:, None], around), -shares[patch, None])
        matrices[number, rows, own] += shares[patch] * neighbours.shape[1]
    return PatchLaplacian(jnp.asarray(columns), jnp.asarray(matrices, metric.diagonal.dtype))


def laplacian_rows(blocks: PatchLaplacian, field: Float[Array, "V C"]) -> Float[Array, "R C"]:
    """Compute `L e` at the vertices of the blocks, patch by patch, with rows of zeros as padding."""
    rows = jnp.einsum("brh,bhc->brc", blocks.matrices, field[blocks.columns])
    return rows.reshape(-1, field.shape[1])


def _grow_patches(
    neighbours: Int[np.ndarray, "V N"], vertices: Int[np.ndarray, "S"], size: int
) -> list[Int[np.ndarray, "R"]]:
    """Partition vertices into patches of at most `size`, each grown breadth first."""
    wanted = np.zeros(len(neighbours), bool)
    wanted[vertices] = True
    visited = np.zeros(len(neighbours), int)
    patches: list[np.ndarray] = []
    patch: list[int] = []
    for seed in vertices.tolist():
        queue = [seed] if wanted[seed] else []
        while queue:
            vertex = queue.pop(0)
            if wanted[vertex]:
                wanted[vertex] = False
                patch.append(vertex)
                if len(patch) == size:
                    patches.append(np.array(patch))
                    patch, queue = [], []
            for near in neighbours[vertex].tolist():
                if visited[near] != len(patches) + 1 and wanted[near]:
                    visited[near] = len(patches) + 1
                    queue.append(near)
    return [*patches, np.array(patch)] if patch else patches
