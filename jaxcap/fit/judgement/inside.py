"""Surface that lies within another part of the body, as legs do that were taken for each other."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

#: winding numbers from which on a sample lies within, and from which on it does so whole
BEGINS, WHOLE = 0.4, 0.7


def within_others(
    points: Float[Array, "S 3"],
    normals: Float[Array, "S 3"],
    areas: Float[Array, "S"],
    regions: Int[Array, "S"],
    apart: Float[Array, "R R"],
    nearest: Float[Array, ""] | float,
) -> Float[Array, "S"]:
    """Return how far each sample of a surface lies within regions that are `apart` from its own: zero to one.

    That is so where the winding number of these regions is near one: the solid angle that their areas fill, seen from
    behind, over that of the whole sphere (Jacobson et al. 2013, "Robust inside-outside segmentation using generalized
    winding numbers"); regions may be open. **Arguments:** `points` about their middle, metres; unit `normals`; `areas` in
    square metres; samples nearer than `nearest` metres count as so far away, as a sample stands for an area.
    """
    of = (regions[:, None] == jnp.arange(len(apart))).astype(points.dtype)
    squared = jnp.sum(points**2, 1)[:, None] - 2 * points @ points.T + jnp.sum(points**2, 1)
    behind = jnp.sum(points * normals, 1) - points @ normals.T
    angles = behind * jax.lax.rsqrt(jnp.maximum(squared, nearest**2)) ** 3
    winding = jnp.sum((angles @ (areas[:, None] * of)) * apart[regions], 1) / (4 * jnp.pi)
    return jnp.clip((winding - BEGINS) / (WHOLE - BEGINS), 0.0, 1.0)
