"""Search for the nearest vertex with a compatible normal, for every point and every part of a body.

Points are grouped in tiles of 32, vertices in blocks of 32, and a tile is compared with a block only if their
boxes are within reach of each other. For each such pair, a loop over the block's vertices, some at a time, is
a few elementwise passes: exact, and several times faster on a CPU than `argmin`, which XLA does not vectorise
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
TILE = 32
#: Pairs of a tile and a block in one step of the culled search.
CHUNK = 256
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
        lambda: _nearest_in_reach(tiles, blocks, near),
        lambda: _nearest_in_blocks(tiles[None], blocks[:, None]),
    )
    squared, vertex = _without_fusion(lambda a, b: _nearest_by_part(parts, a, b, reach), squared, slot)
    return squared[:, :count], vertex[:, :count]


def _tiles_and_blocks(
    parts, vertices, normals, cloud, normal_threshold
) -> tuple[Float[Array, "T 8 32"], Float[Array, "B 6 32"]]:
    """Arrange rows of tiles (position, normal, minimal cosine, weight) and of blocks (position, normal)."""
    limits = jnp.where(jnp.any(cloud.normals != 0, -1), normal_threshold, -jnp.inf).astype(cloud.points.dtype)
    rows = jnp.concatenate([cloud.points, cloud.normals, limits[:, None], cloud.weights[:, None]], 1)
    rows = jnp.pad(rows, ((0, -len(rows) % TILE), (0, 0)))
    tiles = jnp.swapaxes(rows.reshape(-1, TILE, 8), 1, 2)
    return tiles, jnp.swapaxes(jnp.concatenate([vertices, normals], 1)[parts.slots], 1, 2)


def _in_reach(tiles: Float[Array, "T 8 32"], blocks: Float[Array, "B 6 32"], reach) -> Bool[Array, "B T"]:
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


def _nearest_in_blocks(tiles: Float[Array, "*#pairs 8 32"], blocks: Float[Array, "*#pairs 6 32"]):
    """Find the nearest compatible slot of a block, and its squared distance, for each point of a tile."""
    x, y, z, nx, ny, nz, limit, _ = (tiles[..., i, :] for i in range(8))
    shape = jnp.broadcast_shapes(tiles.shape[:-2], blocks.shape[:-2])
    best = jnp.full((*shape, TILE), jnp.inf, tiles.dtype)
    slot = jnp.zeros(best.shape, jnp.int32)

    def step(i, found):
        best, slot = found
        some = lax.dynamic_slice_in_dim(blocks, i * UNROLLED, UNROLLED, -1)
        for s in range(UNROLLED):
            vx, vy, vz, ux, uy, uz = (some[..., i, s, None] for i in range(6))
            squared = (x - vx) ** 2 + (y - vy) ** 2 + (z - vz) ** 2
            better = (squared < best) & (nx * ux + ny * uy + nz * uz > limit)
            best = jnp.where(better, squared, best)
            slot = jnp.where(better, i * UNROLLED + s, slot)
        return best, slot

    return lax.fori_loop(0, BLOCK // UNROLLED, step, (best, slot))


def _nearest_in_reach(tiles, blocks, near):
    """Run `_nearest_in_blocks` on the pairs in reach only, which are listed first, in as many steps as needed."""
    num_tiles, total = len(tiles), near.size
    chosen = near.reshape(-1)
    place = jnp.where(chosen, jnp.cumsum(chosen.astype(jnp.int32)) - 1, total + CHUNK)
    pairs = (
        jnp.full(total + CHUNK, total, jnp.int32)
        .at[place]
        .set(jnp.arange(total, dtype=jnp.int32), mode="drop")
    )

    def step(i, found):
        pair = lax.dynamic_slice(pairs, (i * CHUNK,), (CHUNK,))
        block = jnp.take(blocks, pair // num_tiles, axis=0, mode="clip")
        new = _without_fusion(_nearest_in_blocks, tiles[pair % num_tiles], block)
        return tuple(old.at[pair].set(rows, mode="drop") for old, rows in zip(found, new, strict=True))

    start = (jnp.full((total, TILE), jnp.inf, tiles.dtype), jnp.zeros((total, TILE), jnp.int32))
    found = lax.fori_loop(0, (jnp.sum(chosen) + CHUNK - 1) // CHUNK, step, start)
    return tuple(rows.reshape(*near.shape, TILE) for rows in found)


def _nearest_by_part(parts: PartBlocks, squared: Float[Array, "B T 32"], slot: Int[Array, "B T 32"], reach):
    """Find the best of each part's blocks, `(K, N)`, by a running minimum that restarts with every part."""
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
    best, place = (rows[last].reshape(len(last), -1) for rows in (best, place))
    # excludes also pairs beyond reach within a box in reach, so that the result does not depend on the tiles
    here = jnp.isfinite(best) & (best <= jnp.asarray(reach, best.dtype) ** 2) & (counts > 0)[:, None]
    return jnp.where(here, best, jnp.inf), jnp.where(here, parts.slots.reshape(-1)[place], 0)


def _without_fusion(function, *arguments):
    """Compute `function(*arguments)`, compiled separately from the code before and after.

    On a CPU, XLA drops optimisation barriers, and fuses long elementwise stages into one loop that computes
    the earlier stage again for every use in the later one. A condition on data prevents this fusion.
    """
    always = arguments[0].ravel()[0] != -jnp.inf
    shapes = jax.eval_shape(function, *arguments)
    empty = jax.tree.map(lambda s: jnp.zeros(s.shape, s.dtype), shapes)
    return lax.cond(always, lambda: function(*arguments), lambda: empty)
