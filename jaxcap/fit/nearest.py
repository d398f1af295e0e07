"""For every point and every part of a body, the nearest vertex with a compatible normal."""

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float, Int

from ..observe import Cloud
from .parts import BLOCK, Parts


def nearest_vertices(
    parts: Parts,
    vertices: Float[Array, "V 3"],
    normals: Float[Array, "V 3"],
    cloud: Cloud,
    *,
    normal_threshold: float | Float[Array, ""],
) -> tuple[Float[Array, "K N"], Int[Array, "K N"]]:
    """`v_ik` of Kineben, section 3.3.1: squared distance (metres^2) and vertex.

    A vertex is compatible where `dot(n_point, n_vertex) > normal_threshold`, and with every
    point whose normal is zero (not known). Where a part has no compatible vertex the squared
    distance is infinite and the vertex is 0.
    """
    known = jnp.any(cloud.normals != 0, -1)
    limits = jnp.where(known, normal_threshold, -jnp.inf).astype(cloud.points.dtype)
    point = [*cloud.points.T, *cloud.normals.T, limits]
    blocks = jnp.concatenate([vertices, normals], 1)[parts.slots]
    block = [blocks[:, :, c] for c in range(6)]
    squared, slot = _apart(_sweep, point, block)
    return _apart(lambda a, b: _by_part(parts, a, b), squared, slot)


def _apart(function, *arguments):
    """`function(*arguments)`, compiled apart from what comes before and after.

    On a CPU, XLA drops optimisation barriers, and fuses long elementwise stages into one loop
    that computes the earlier stage again for every use in the later one. It cannot see through
    a condition on data.
    """
    likely = jax.tree.leaves(arguments)[0].ravel()[0] > -jnp.inf
    shapes = jax.eval_shape(function, *arguments)
    empty = jax.tree.map(lambda s: jnp.zeros(s.shape, s.dtype), shapes)
    return lax.cond(likely, lambda: function(*arguments), lambda: empty)


def _sweep(point, block):
    """Nearest compatible slot of every block `(B, N)`.

    Unrolled over the slots of a block, this is one elementwise loop over points: exact, and
    several times faster on a CPU than `argmin`, which does not vectorise.
    """
    x, y, z, nx, ny, nz, limit = (p[None, :] for p in point)
    best = jnp.full((block[0].shape[0], x.shape[1]), jnp.inf, x.dtype)
    slot = jnp.zeros(best.shape, jnp.int32)
    for s in range(BLOCK):
        vx, vy, vz, ux, uy, uz = (b[:, s, None] for b in block)
        squared = (x - vx) ** 2 + (y - vy) ** 2 + (z - vz) ** 2
        better = (squared < best) & (nx * ux + ny * uy + nz * uz > limit)
        best = jnp.where(better, squared, best)
        slot = jnp.where(better, s, slot)
    return best, slot


def _by_part(parts: Parts, squared, slot):
    """The best of each part's blocks, `(K, N)`."""
    num_points = squared.shape[1]
    distances, vertices = [], []
    first = 0
    for count in parts.blocks_of_part:
        best = jnp.full((num_points,), jnp.inf, squared.dtype)
        place = jnp.zeros((num_points,), jnp.int32)
        for b in range(first, first + count):
            better = squared[b] < best
            best = jnp.where(better, squared[b], best)
            place = jnp.where(better, b * BLOCK + slot[b], place)
        distances.append(best)
        vertices.append(jnp.where(jnp.isfinite(best), parts.slots.reshape(-1)[place], 0))
        first += count
    return jnp.stack(distances), jnp.stack(vertices)
