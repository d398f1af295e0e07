"""Rest vertices from the pairs of many frames, held to the shape that people have (Adaptation, 4.1.3)."""

import itertools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy.sparse
import scipy.sparse.linalg
from jaxtyping import Array, Float, Int

from ..body.body import Body
from ..body.pose import Pose
from ..fit.correspond import Pairs, places_on
from ..geometry.mesh import mesh_edges
from .equations import pair_rows, vertex_maps
from .shape_prior import ShapePrior
from .shape_prior import own_shape_prior as own_shape_prior


def adapt_shape(
    body: Body, poses: Pose, pairs: Pairs, prior: ShapePrior, weight: float, hold: float = 1e-4
) -> Body:
    """The rest vertices that make least of the pairs' squared distances, summed over frames, plus `weight`
    times the squared change of the Laplacian vectors, mean over the prior's poses: one sparse system.

    `hold` ties every vertex weakly to where it is, as a part that no scan shows is only known by its shape.
    """
    count = len(body.vertices)
    # vertices of one triangle are coupled by the pairs within it; those at vertices couple nothing
    edges = mesh_edges(np.asarray(body.faces)) if pairs.vertices.shape[-1] > 1 else np.zeros((0, 2), int)
    slots = jnp.asarray(pair_slots(pairs, edges, count), jnp.int32)
    blocks, sides = (np.array(part, float) for part in pair_blocks(body, poses, pairs, slots, len(edges)))
    # a pair's weight is about one at most, so a vertex weighs about as many as frames show it
    blocks[:count] += hold * np.eye(3)
    matrix = _block_matrix(blocks, edges, count)
    side = sides.reshape(-1)
    maps, places = (np.asarray(part, float) for part in _maps(body, prior.poses))
    wide = scipy.sparse.kron(prior.laplacian, scipy.sparse.identity(3), format="csr")
    share, none = weight / len(prior.vectors), np.zeros((0, 2), int)
    for number in range(len(prior.vectors)):
        rough = wide @ _block_matrix(maps[number], none, count)
        missing = (prior.vectors[number] - prior.laplacian @ places[number]).reshape(-1)
        matrix = matrix + share * (rough.T @ rough)
        side = side + share * (rough.T @ missing)
    step = scipy.sparse.linalg.spsolve(matrix.tocsc(), side).reshape(count, 3)
    vertices = body.vertices + jnp.asarray(step, body.vertices.dtype)
    return eqx.tree_at(lambda b: b.vertices, body, vertices)


def pair_slots(pairs: Pairs, edges: Int[np.ndarray, "E 2"], count: int) -> Int[np.ndarray, "F C P"]:
    """The block that each two of a pair's vertices couple: of an edge behind those of the `count` vertices, in
    the edges' order; a vertex with itself is its own.

    **Raises:** `ValueError` where two vertices of a pair share no edge.
    """
    rows = np.asarray(pairs.vertices, np.int64)
    keys = edges[:, 0] * np.int64(count) + edges[:, 1]
    slots = np.zeros((*rows.shape[:2], len(_couples(rows.shape[2]))), np.int64)
    for number, (k, other) in enumerate(_couples(rows.shape[2])):
        low, high = np.minimum(rows[..., k], rows[..., other]), np.maximum(rows[..., k], rows[..., other])
        found = np.searchsorted(keys, low * count + high)
        known = (low == high) | (keys[np.minimum(found, len(keys) - 1)] == low * count + high)
        if not known.all():
            frame, pair = np.argwhere(~known)[0]
            raise ValueError(
                f"Pair {pair} of frame {frame} joins vertices {low[frame, pair]} and {high[frame, pair]}, which "
                "share no edge; give pairs of points in triangles of the body."
            )
        slots[..., number] = np.where(low == high, low, count + found)
    return slots


def _couples(corners: int) -> list[tuple[int, int]]:
    return list(itertools.combinations(range(corners), 2))


@eqx.filter_jit
def pair_blocks(
    body: Body, poses: Pose, pairs: Pairs, slots: Int[Array, "F C P"], num_edges: int
) -> tuple[Float[Array, "B 3 3"], Float[Array, "V 3"]]:
    """Normal equations summed over frames: blocks of vertices, then those of edges from the lesser vertex to
    the greater, and the right sides."""
    couples = _couples(pairs.vertices.shape[-1])

    def of_frame(total, frame):
        pose, pairs, slots = frame
        matrices, sides = total
        maps, places = vertex_maps(body, pose)
        directions = pair_rows(pairs)
        rows = jnp.einsum("ck,cra,ckab->ckrb", pairs.shares, directions, maps[pairs.vertices])
        apart = jnp.einsum("cra,ca->cr", directions, pairs.points - places_on(pairs, places))
        matrices = matrices.at[pairs.vertices].add(jnp.einsum("ckra,ckrb->ckab", rows, rows))
        sides = sides.at[pairs.vertices].add(jnp.einsum("ckra,cr->cka", rows, apart))
        for number, (k, other) in enumerate(couples):
            block = jnp.einsum("cra,crb->cab", rows[:, k], rows[:, other])
            turned = jnp.swapaxes(block, 1, 2)
            first, second = (pairs.vertices[:, i, None, None] for i in (k, other))
            # a vertex that is there twice has both halves of the coupling on its diagonal
            block = jnp.where(first < second, block, turned) + jnp.where(first == second, block, 0.0)
            matrices = matrices.at[slots[:, number]].add(block)
        return (matrices, sides), None

    zero = jnp.zeros((len(body.vertices) + num_edges, 3, 3), body.vertices.dtype)
    total, _ = jax.lax.scan(of_frame, (zero, zero[: len(body.vertices), 0]), (poses, pairs, slots))
    return total


@eqx.filter_jit
def _maps(body: Body, poses: Pose):
    return jax.lax.map(lambda pose: vertex_maps(body, pose), poses)


def _block_matrix(
    blocks: Float[np.ndarray, "B 3 3"], edges: Int[np.ndarray, "E 2"], count: int
) -> scipy.sparse.csr_matrix:
    """The symmetric matrix of blocks on the diagonal and, behind them, of edges."""
    every = np.arange(count)
    rows = np.concatenate([every, edges[:, 0], edges[:, 1]])
    columns = np.concatenate([every, edges[:, 1], edges[:, 0]])
    values = np.concatenate([blocks, np.swapaxes(blocks[count:], 1, 2)])
    order = np.lexsort((columns, rows))
    starts = np.concatenate([[0], np.cumsum(np.bincount(rows, minlength=count))])
    shape = (3 * count, 3 * count)
    wide = scipy.sparse.bsr_matrix((values[order], columns[order], starts), shape=shape)
    return scipy.sparse.csr_matrix(wide)
