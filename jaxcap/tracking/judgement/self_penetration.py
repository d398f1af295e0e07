"""Detection of surface within another part of the body, as of two confused legs."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

#: winding numbers at which a sample begins to count as inside, and at which it counts fully
MIN_WINDING, FULL_WINDING = 0.4, 0.7


def inside_degrees(
    points: Float[Array, "S 3"],
    normals: Float[Array, "S 3"],
    areas: Float[Array, "S"],
    regions: Int[Array, "S"],
    non_adjacent: Float[Array, "R R"],
    min_distance: Float[Array, ""] | float,
) -> Float[Array, "S"]:
    """Compute the degree, zero to one, to which each sample lies within regions that are `non_adjacent` from its
    own.

    The sample is inside if the winding number of these regions is near one: the solid angle of their areas,
    seen from behind, divided by that of the whole sphere (Jacobson et al. 2013, "Robust inside-outside
    segmentation using generalized winding numbers"); regions may be open. **Arguments:** `points` about their
    mean, metres; unit `normals`; `areas` in square metres; distances below `min_distance` metres count as
    `min_distance`, as a sample represents an area.
    """
    of = (regions[:, None] == jnp.arange(len(non_adjacent))).astype(points.dtype)
    squared = jnp.sum(points**2, 1)[:, None] - 2 * points @ points.T + jnp.sum(points**2, 1)
    behind = jnp.sum(points * normals, 1) - points @ normals.T
    angles = behind * jax.lax.rsqrt(jnp.maximum(squared, min_distance**2)) ** 3
    winding = jnp.sum((angles @ (areas[:, None] * of)) * non_adjacent[regions], 1) / (4 * jnp.pi)
    return jnp.clip((winding - MIN_WINDING) / (FULL_WINDING - MIN_WINDING), 0.0, 1.0)
