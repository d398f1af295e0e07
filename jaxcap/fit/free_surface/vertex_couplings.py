"""Normal equations of vertices from matches of points in triangles: 3 x 3 blocks of vertices and edges."""

import itertools

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ...energy.data.pairs import PointPairs
from ...geometry.mesh import mesh_edges


class Couplings(eqx.Module):
    """The couplings of vertices by the pairs of a frame, or of all frames."""

    edges: Int[Array, "E 2"]
    #: the block of each two of a pair's vertices: that of a vertex, or, after all of these, of an edge
    block_indices: Int[Array, "*frames C P"]


class VertexEquations(eqx.Module):
    """Normal equations over vertices: blocks of vertices, then of edges, and the right side."""

    blocks: Float[Array, "B 3 3"]
    side: Float[Array, "V 3"]


def find_couplings(faces: Int[np.ndarray, "F 3"], num_vertices: int, pairs: PointPairs) -> Couplings:
    """Find the couplings of the vertices of a mesh by pairs.

    **Raises:** `ValueError` if two vertices of a pair share no edge.
    """
    count, rows = num_vertices, np.asarray(pairs.vertices, np.int64)
    # pairs within a triangle couple its vertices; pairs at vertices couple none
    edges = mesh_edges(faces) if rows.shape[-1] > 1 else np.zeros((0, 2), int)
    keys = edges[:, 0] * np.int64(count) + edges[:, 1]
    slots = np.zeros((*rows.shape[:-1], len(_corner_pairs(rows.shape[-1]))), np.int64)
    for number, (k, other) in enumerate(_corner_pairs(rows.shape[-1])):
        low, high = np.minimum(rows[..., k], rows[..., other]), np.maximum(rows[..., k], rows[..., other])
        found = np.searchsorted(keys, low * count + high)
        known = (low == high) | (keys[np.minimum(found, len(keys) - 1)] == low * count + high)
        if not known.all():
            wrong = tuple(np.argwhere(~known)[0])
            frame = "" if len(wrong) == 1 else f" of frame {wrong[0]}"
            raise ValueError(
                f"Pair {wrong[-1]}{frame} couples vertices {low[wrong]} and {high[wrong]}, which "
                "share no edge; give pairs of points in triangles of the body."
            )
        slots[..., number] = np.where(low == high, low, count + found)
    return Couplings(jnp.asarray(edges, jnp.int32), jnp.asarray(slots, jnp.int32))


def no_equations(couplings: Couplings, num_vertices: int, dtype) -> VertexEquations:
    """Make the equations of no pairs."""
    blocks = jnp.zeros((num_vertices + len(couplings.edges), 3, 3), dtype)
    return VertexEquations(blocks, blocks[:num_vertices, 0])


def add_pairs(
    total: VertexEquations,
    rows: Float[Array, "C K R 3"],
    residuals: Float[Array, "C R"],
    vertices: Int[Array, "C K"],
    block_indices: Int[Array, "C P"],
) -> VertexEquations:
    """Add the pairs of a frame, given the residuals and their derivatives by the vertices of each pair, `rows`."""
    blocks = total.blocks.at[vertices].add(jnp.einsum("ckra,ckrb->ckab", rows, rows))
    side = total.side.at[vertices].add(-jnp.einsum("ckra,cr->cka", rows, residuals))
    for number, (k, other) in enumerate(_corner_pairs(vertices.shape[1])):
        block = jnp.einsum("cra,crb->cab", rows[:, k], rows[:, other])
        turned = jnp.swapaxes(block, 1, 2)
        first, second = (vertices[:, i, None, None] for i in (k, other))
        # a repeated vertex has both halves of the coupling on its diagonal
        block = jnp.where(first < second, block, turned) + jnp.where(first == second, block, 0.0)
        blocks = blocks.at[block_indices[:, number]].add(block)
    return VertexEquations(blocks, side)


def _corner_pairs(corners: int) -> list[tuple[int, int]]:
    return list(itertools.combinations(range(corners), 2))
