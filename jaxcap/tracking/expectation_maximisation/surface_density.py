"""Density of points on the surface of a body as a whole, by which poses are compared."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from ...body.body import Posed
from ...fit.correspondence.part_blocks import PartBlocks
from ...observe.clouds import Cloud
from .clothes import Clothes, clothes_log_density
from .e_step import MIN_OUTLIER, Posterior


def surface_log_density(
    found: Posterior,
    parts: PartBlocks,
    posed: Posed,
    cloud: Cloud,
    sigma: Float[Array, ""],
    outlier: Float[Array, ""],
    box_volume: Float[Array, ""],
    tangential_weight: Float[Array, ""],
    clothes: Clothes | None = None,
) -> Float[Array, "N"]:
    """Compute the log-density of each point, where a point lies on its likeliest part only.

    The density of `posterior` is a sum over parts. It rises where parts overlap: a limb that no camera sees would be
    likeliest inside of a part that is seen. Here overlapping parts are one surface. The distance from a part is that
    across the surface and `tangential_weight` of that along it, as in the M-step, so that the density does not depend on
    the distances between vertices.

    **Arguments:** `found` at the same `posed`, `cloud` and `sigma`; the others as in `posterior`. Points of weight zero
    have no meaning.
    """
    log_part = matched_log_density(found, parts, posed, cloud, sigma, tangential_weight)
    if clothes is not None:
        first = found.parts[:, 0], found.vertices[:, 0], found.squared_distances[:, 0]
        worn, is_outside = clothes_log_density(
            clothes.spread(sigma), *first, posed.vertices, posed.normals, cloud
        )
        present = sum(count > 0 for count in parts.blocks_of_part)
        of_clothes = clothes.worn_share[first[0]]
        worn = jnp.where(is_outside, worn, -jnp.inf)
        log_part = jnp.logaddexp(
            log_part + jnp.log1p(-of_clothes), worn + jnp.log(of_clothes) - jnp.log(present)
        )
    share = jnp.maximum(outlier, MIN_OUTLIER)
    log_outlier = jnp.log(share) - jnp.log(box_volume)
    return jnp.logaddexp(jnp.log1p(-share) + log_part, log_outlier)


def matched_log_density(
    found: Posterior,
    parts: PartBlocks,
    posed: Posed,
    cloud: Cloud,
    sigma: Float[Array, ""],
    tangential_weight: Float[Array, ""],
) -> Float[Array, "N"]:
    """Compute the log-density of each point on its likeliest part, without an outlier class.

    It is minus infinity where no part explains the point.

    **Arguments:** as in `surface_log_density`.
    """
    best = jnp.argmax(found.weights, axis=1)[:, None]
    rows = jnp.take_along_axis(found.vertices, best, 1)[:, 0]
    explained = jnp.take_along_axis(found.weights, best, 1)[:, 0] > 0
    away = cloud.points - posed.vertices[rows]
    across = jnp.sum(away * posed.normals[rows], -1) ** 2
    squared = across + tangential_weight * (jnp.sum(away**2, -1) - across)
    present = sum(count > 0 for count in parts.blocks_of_part)
    log_part = -jnp.log(present) - 1.5 * jnp.log(2 * jnp.pi * sigma**2) - squared / (2 * sigma**2)
    return jnp.where(explained, log_part, -jnp.inf)
