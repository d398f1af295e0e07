"""Search for the nearest vertex with a compatible normal, for every point and every part of a body.

Points are grouped in tiles of 16, vertices in blocks of 32, and a tile is compared with a block only if their
boxes are within reach of each other. For each such pair, a loop over the block's vertices, some at a time, is
a few elementwise passes: several times faster on a CPU than `argmin`, which XLA does not vectorise
there.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from ...observe.clouds import Cloud
from .part_blocks import BLOCK, PartBlocks

#: Points in a tile.
TILE = 16
#: Pairs of a tile and a block in one step of the culled search.
CHUNK = 512
#: Vertices of a block in one elementwise pass; all of them compile far longer and run little faster.
UNROLLED = 8
#: Share of pairs in reach above which a search of all pairs in one pass is faster.
MAX_CULLED_SHARE = 0.3


def nearest_vertices(
    parts: PartBlocks,
    vertices: Float[Array, "V 3"],
    normals: Float[Array, "V 3"],
    cloud: Cloud,
    *,
    normal_threshold: float | Float[Array, ""],
    reach: float | Float[Array, ""] = jnp.inf,
) -> tuple[Float[Array, "K N"], Int[Array, "K N"]]:
    """Find `v_ik` of Kineben, section 3.3.1: squared distance (metres^2) and vertex.

    A vertex is compatible where `dot(n_point, n_vertex) > normal_threshold`, and with every point with zero
    normal (unknown). Where a part has no compatible vertex within `reach` metres, the squared distance is
    infinite and the vertex is 0. The same holds for padding, where `reach` is finite.

    The result does not depend on the points' order, but the time does: a small reach is faster where
    neighbours in the array are neighbours in space, as ordered by `spatial_order`.
    """
    count = len(cloud.points)
    tiles, blocks = _tiles_and_blocks(parts, vertices, normals, cloud, normal_threshold)
    near = _in_reach(tiles, blocks, reach)
    squared, slot = lax.cond(
        jnp.sum(near) < MAX_CULLED_SHARE * near.size,
        lambda: _nearest_in_reach(parts, tiles, blocks, near),
        lambda: _nearest_by_part(parts, *_nearest_in_blocks(tiles[None], blocks[:, None])),
    )
    # excludes also pairs beyond reach within a box in reach, so that the result does not depend on the tiles
    squared, slot = (found.reshape(parts.num_parts, -1)[:, :count] for found in (squared, slot))
    here = jnp.isfinite(squared) & (squared <= jnp.asarray(reach, squared.dtype) ** 2)
    return jnp.where(here, squared, jnp.inf), jnp.where(here, parts.slots.reshape(-1)[slot], 0)


def _tiles_and_blocks(
    parts, vertices, normals, cloud, normal_threshold
) -> tuple[Float[Array, "T 8 16"], Float[Array, "B 6 32"]]:
    """Arrange rows of tiles (position, normal, minimal cosine, weight) and of blocks (position, normal)."""
    limits = jnp.where(jnp.any(cloud.normals != 0, -1), normal_threshold, -jnp.inf).astype(cloud.points.dtype)
    rows = jnp.concatenate([cloud.points, cloud.normals, limits[:, None], cloud.weights[:, None]], 1)
    rows = jnp.pad(rows, ((0, -len(rows) % TILE), (0, 0)))
    tiles = jnp.swapaxes(rows.reshape(-1, TILE, 8), 1, 2)
    return tiles, jnp.swapaxes(jnp.concatenate([vertices, normals], 1).astype(tiles.dtype)[parts.slots], 1, 2)


def _in_reach(tiles: Float[Array, "T 8 16"], blocks: Float[Array, "B 6 32"], reach) -> Bool[Array, "B T"]:
    """Test if the box of a tile's points without padding is within reach of a block's box."""
    real = tiles[:, 7:] > 0
    low = jnp.min(jnp.where(real, tiles[:, :3], jnp.inf), 2)
    high = jnp.max(jnp.where(real, tiles[:, :3], -jnp.inf), 2)
    block_low, block_high = jnp.min(blocks[:, :3], 2), jnp.max(blocks[:, :3], 2)
    squared = jnp.zeros((len(blocks), len(tiles)), tiles.dtype)
    for axis in range(3):
        gap = jnp.maximum(block_low[:, axis, None] - high[:, axis], low[:, axis] - block_high[:, axis, None])
        squared += jnp.maximum(gap, 0.0) ** 2
    # the thousandth compensates for rounding
    return squared <= 1.001 * jnp.asarray(reach, tiles.dtype) ** 2


def _nearest_in_blocks(tiles: Float[Array, "*#pairs 8 16"], blocks: Float[Array, "*#pairs 6 32"]):
    """Find the nearest compatible slot of a block, and its squared distance, for each point of a tile.

    The squared distance loses its last five bits, 4e-6 of it in single precision, and has no derivative.
    """
    x, y, z, nx, ny, nz, limit, _ = (tiles[..., i, :] for i in range(8))
    shape = jnp.broadcast_shapes(tiles.shape[:-2], blocks.shape[:-2])
    # numbers of at least zero are in the order of their bits; the last bits hold the slot, so that one minimum finds both
    integer = jnp.int64 if tiles.dtype.itemsize == 8 else jnp.int32
    none = lax.bitcast_convert_type(jnp.asarray(jnp.inf, tiles.dtype), integer)

    def step(i, best):
        some = lax.dynamic_slice_in_dim(blocks, i * UNROLLED, UNROLLED, -1)
        for s in range(UNROLLED):
            vx, vy, vz, ux, uy, uz = (some[..., i, s, None] for i in range(6))
            squared = (x - vx) ** 2 + (y - vy) ** 2 + (z - vz) ** 2
            # what is not a number may have a sign
            is_compatible = (nx * ux + ny * uy + nz * uz > limit) & (squared >= 0)
            bits = lax.bitcast_convert_type(squared, integer) & ~(BLOCK - 1)
            best = jnp.minimum(best, jnp.where(is_compatible, bits | (i * UNROLLED + s), none))
        return best

    best = lax.fori_loop(0, BLOCK // UNROLLED, step, jnp.full((*shape, TILE), none))
    squared = lax.bitcast_convert_type(best & ~(BLOCK - 1), tiles.dtype)
    return squared, jnp.where(best < none, best & (BLOCK - 1), 0).astype(jnp.int32)


def _nearest_in_reach(
    parts: PartBlocks, tiles: Float[Array, "T 8 16"], blocks: Float[Array, "B 6 32"], near: Bool[Array, "B T"]
) -> tuple[Float[Array, "KT 16"], Int[Array, "KT 16"]]:
    """Find the nearest slot of each part from the pairs in reach only, which are listed first, in as many steps as needed."""
    num_tiles, total, rows = len(tiles), near.size, parts.num_parts * len(tiles)
    chosen = near.reshape(-1)
    place = jnp.where(chosen, jnp.cumsum(chosen.astype(jnp.int32)) - 1, total + CHUNK)
    pairs = (
        jnp.full(total + CHUNK, total, jnp.int32)
        .at[place]
        .set(jnp.arange(total, dtype=jnp.int32), mode="drop")
    )
    parts_of_blocks = jnp.asarray(np.repeat(np.arange(parts.num_parts), parts.blocks_of_part), jnp.int32)

    def step(i, found):
        pair = lax.dynamic_slice(pairs, (i * CHUNK,), (CHUNK,))
        block, tile = jnp.minimum(pair // num_tiles, parts.num_blocks - 1), pair % num_tiles
        squared, slot = _without_fusion(_nearest_in_blocks, tiles[tile], blocks[block])
        row = jnp.where(pair < total, parts_of_blocks[block] * num_tiles + tile, rows)
        best, place = found
        return _keep_nearest(best, place, row, squared, block[:, None] * BLOCK + slot)

    start = jnp.full((rows, TILE), jnp.inf, tiles.dtype), jnp.zeros((rows, TILE), jnp.int32)
    return lax.fori_loop(0, (jnp.sum(chosen) + CHUNK - 1) // CHUNK, step, start)


def _keep_nearest(
    best: Float[Array, "R 16"],
    place: Int[Array, "R 16"],
    row: Int[Array, "P"],
    squared: Float[Array, "P 16"],
    slot: Int[Array, "P 16"],
) -> tuple[Float[Array, "R 16"], Int[Array, "R 16"]]:
    """Keep the smallest squared distance of each row, and its slot; of several new ones for one row the first of equal ones.

    Rows beyond the last are dropped.
    """
    nearer = squared < best.at[row].get(mode="fill", fill_value=-jnp.inf)
    best = best.at[row].min(squared, mode="drop")
    winner = nearer & (squared == best.at[row].get(mode="fill", fill_value=-jnp.inf))
    last = np.iinfo(np.int32).max
    place = place.at[row].max(jnp.where(nearer, last, -1), mode="drop")
    return best, place.at[row].min(jnp.where(winner, slot, last), mode="drop")


def _nearest_by_part(
    parts: PartBlocks, squared: Float[Array, "B T 16"], slot: Int[Array, "B T 16"]
) -> tuple[Float[Array, "KT 16"], Int[Array, "KT 16"]]:
    """Find the best of each part's blocks by a running minimum that restarts with every part."""
    counts = np.array(parts.blocks_of_part)
    last = np.cumsum(counts) - 1
    begins = np.isin(np.arange(parts.num_blocks), last - counts + 1)

    def step(found, row):
        best, place = found
        squared, slot, begins, first = row
        better = begins | (squared < best)
        found = jnp.where(better, squared, best), jnp.where(better, first + slot, place)
        return found, found

    shape = squared.shape[1:]
    start = (jnp.full(shape, jnp.inf, squared.dtype), jnp.zeros(shape, jnp.int32))
    firsts = jnp.arange(parts.num_blocks, dtype=jnp.int32) * BLOCK
    _, (best, place) = lax.scan(step, start, (squared, slot, jnp.asarray(begins), firsts))
    best = jnp.where((counts > 0)[:, None, None], best[last], jnp.inf)
    return best.reshape(-1, TILE), place[last].reshape(-1, TILE)


def _without_fusion(function, *arguments):
    """Compute `function(*arguments)`, compiled separately from the code before and after.

    On a CPU, XLA drops optimisation barriers, and fuses long elementwise stages into one loop that computes
    the earlier stage again for every use in the later one. A condition on data prevents this fusion.
    """
    always = arguments[0].ravel()[0] != -jnp.inf
    shapes = jax.eval_shape(function, *arguments)
    empty = jax.tree.map(lambda s: jnp.zeros(s.shape, s.dtype), shapes)
    return lax.cond(always, lambda: function(*arguments), lambda: empty)
