"""The Laplacian of fields with many columns, by patches of the mesh."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from .laplacian import Conformance


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
    met = np.zeros(len(neighbours), int)
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
                if met[near] != len(patches) + 1 and wanted[near]:
                    met[near] = len(patches) + 1
                    queue.append(near)
    return [*patches, np.array(patch)] if patch else patches
