"""The E-step: posterior probabilities of parts and of the outlier class for each point."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ...arguments import checked
from ...fit.correspondence.nearest import nearest_vertices
from ...fit.correspondence.part_blocks import PartBlocks
from ...observe.clouds import Cloud
from .clothes import Clothes, clothes_log_density, clothes_reach

#: Least share of the outlier class: the negligible uniform density of Kineben, eq. 20, without which a point
#: with no compatible vertex would have no posterior.
MIN_OUTLIER = 1e-9
#: difference of log-densities within which parts are equally likely
TIE = 1e-4


class Posterior(eqx.Module):
    """Soft assignment of N points to C candidate parts each and to the outlier class.

    C is the number of parts, in their order, or fewer: then a point's candidates are its most likely parts,
    likeliest first. A weight of zero is no correspondence, whatever its vertex.
    """

    #: nearest compatible vertex of each candidate part
    vertices: Int[Array, "N C"]
    parts: Int[Array, "N C"]
    #: posterior probability of each candidate part
    weights: Float[Array, "N C"]
    #: posterior probability that no part explains the point
    outlier: Float[Array, "N"]
    #: squared distance to the vertex in metres^2, infinite where there is no correspondence
    squared_distances: Float[Array, "N C"]
    #: log of the mixture's density at the point, per metre^3; zero for padding
    log_density: Float[Array, "N"]
    #: posterior probability that the point belongs to the clothes of its first candidate
    clothes: Float[Array, "N"]
    #: the same if every part had clothes, from which clothes are learned
    possible_clothes: Float[Array, "N"]


def no_posterior(count: int, parts: PartBlocks, candidates: int, dtype) -> Posterior:
    """Make the posterior of `count` points that no part explains."""
    shape = count, min(candidates, parts.num_parts)
    index, zero = jnp.zeros(shape, jnp.int32), jnp.zeros(shape, dtype)
    one = jnp.ones(count, dtype)
    return Posterior(
        index, index, zero, one, jnp.full(shape, jnp.inf, dtype), 0.0 * one, 0.0 * one, 0.0 * one
    )


@checked
def posterior(
    parts: PartBlocks,
    vertices: Float[Array, "V 3"],
    normals: Float[Array, "V 3"],
    cloud: Cloud,
    sigma: float | Float[Array, ""],
    *,
    normal_threshold: float | Float[Array, ""] = 0.5,
    outlier: float | Float[Array, ""] = 0.05,
    box_volume: float | Float[Array, ""] = 10.0,
    priors: Float[Array, "K"] | None = None,
    candidates: int | None = 4,
    clothes: Clothes | None = None,
) -> Posterior:
    """Compute the posterior of every part and of the outlier class at every point (Kineben, eqs. 20, 21).

    The mixture is `p(y) = (1 - w) sum_k prior_k p_k(y) + w / V` with `w` the share `outlier` (at least
    `MIN_OUTLIER`) and `V` the `box_volume`. `p_k` is the isotropic normal density with standard deviation `sigma`
    about the part's nearest vertex with a compatible normal, and zero where there is none. The uniform
    density of eq. 20 for that case belongs to the outlier class, as it attracts no vertex. A part with a
    density below the outlier class's by more than the precision of a number counts as zero, so that distant
    parts need not be searched.

    A posterior is constant in its M-step, so no derivative flows through it; the slope of `log_density` is
    that of the M-step's bound (Fisher's identity).

    **Arguments:** posed `vertices (V, 3)` in metres and unit `normals (V, 3)`; `cloud`, with points of weight
    zero as padding, which go to the outlier class, and zero normals compatible with all others; `sigma`
    metres; `normal_threshold` the least cosine between compatible normals; `outlier` in [0, 1); `box_volume`
    metres^3; `priors (K,)` shares of the parts, sum one, uniform over the parts with vertices where not
    given; `candidates` number C kept for each point, `None` for all K. The omitted ones are the least likely,
    and their probability is not redistributed. With `clothes`, the likeliest part at a point outside of it has another
    density, that of its clothes, and candidates are in the order of their likelihood.
    """
    vertices, normals, cloud, sigma = jax.lax.stop_gradient((vertices, normals, cloud, jnp.asarray(sigma)))
    dtype = cloud.points.dtype
    if priors is None:
        present = jnp.array([count > 0 for count in parts.blocks_of_part])
        priors = present / jnp.sum(present)
    share = jnp.maximum(jnp.asarray(outlier, dtype), MIN_OUTLIER)
    log_shares = jnp.log(priors.astype(dtype)) + jnp.log1p(-share)
    log_normaliser = -1.5 * jnp.log(2 * jnp.pi * sigma**2).astype(dtype)
    log_outlier = jnp.log(share) - jnp.log(jnp.asarray(box_volume, dtype))
    # at this distance exp(-d^2 / (2 sigma^2)) is below rounding, relative to the outlier class
    negligible = np.log(1e-3 * np.finfo(dtype).eps)
    reach = sigma * jnp.sqrt(2 * (jnp.maximum(log_normaliser - log_outlier, 0.0) - negligible))
    if clothes is not None:
        clothes = jax.lax.stop_gradient(clothes).spread(sigma.astype(dtype))
        log_shares = log_shares + jnp.log1p(-clothes.worn_share)
        reach = jnp.maximum(reach, jnp.max(clothes_reach(clothes)))
    squared, nearest = nearest_vertices(
        parts, vertices, normals, cloud, normal_threshold=normal_threshold, reach=reach
    )
    log_parts = log_shares[:, None] + log_normaliser - squared / (2 * sigma**2).astype(dtype)
    which = jnp.broadcast_to(jnp.arange(parts.num_parts, dtype=jnp.int32)[:, None], squared.shape)
    columns = (log_parts, which, nearest, squared)
    if clothes is not None or (candidates is not None and candidates < parts.num_parts):
        columns = _top_candidates(columns, min(candidates or parts.num_parts, parts.num_parts))
    log_clothes = log_possible = jnp.full(len(cloud.weights), -jnp.inf, dtype)
    if clothes is not None:
        first = columns[1][0], columns[2][0], columns[3][0]
        common = jnp.log(priors.astype(dtype))[first[0]] + jnp.log1p(-share)
        density, is_outside = clothes_log_density(clothes, *first, vertices, normals, cloud)
        common = common + density
        log_clothes = jnp.where(is_outside, common + jnp.log(clothes.worn_share[first[0]]), -jnp.inf)
        log_possible = common + jnp.log(clothes.share[first[0]])
    highest = jnp.maximum(jnp.maximum(jnp.max(log_parts, 0), log_outlier), log_clothes)
    total = jnp.sum(jnp.exp(log_parts - highest), 0) + jnp.exp(log_outlier - highest)
    total = total + jnp.exp(log_clothes - highest)
    possible = jnp.exp(log_possible - highest)
    real = cloud.weights > 0
    log_kept, which, nearest, squared = columns
    weights = jnp.where(real, jnp.exp(log_kept - highest) / total, 0.0)
    weights, which, nearest, squared = (column.T for column in (weights, which, nearest, squared))
    return Posterior(
        vertices=nearest,
        parts=which,
        weights=weights,
        outlier=jnp.where(real, jnp.exp(log_outlier - highest) / total, 1.0),
        squared_distances=squared,
        log_density=jnp.where(real, highest + jnp.log(total), 0.0),
        clothes=jnp.where(real, jnp.exp(log_clothes - highest) / total, 0.0),
        possible_clothes=jnp.where(real, possible / (possible + total - jnp.exp(log_clothes - highest)), 0.0),
    )


def _top_candidates(columns, count: int):
    """Select the `count` rows of largest first entry at each point, `(C, N)` each, largest first.

    Removing the largest `count` times is faster on a CPU than `top_k`.
    """
    # finite, so that a row without density differs from one that is already chosen
    values = jnp.maximum(columns[0], -jnp.finfo(columns[0].dtype).max / 2)
    rows = jnp.arange(values.shape[0])[:, None]
    chosen = []
    for _ in range(count):
        # fused code may compute values twice, with other roundings
        largest = values >= jnp.max(values, 0) - TIE
        row = jnp.min(jnp.where(largest, rows, values.shape[0] - 1), 0)
        values, row = jax.lax.optimization_barrier((jnp.where(rows == row, -jnp.inf, values), row))
        chosen.append(row)
    rows = jnp.stack(chosen)
    return tuple(jnp.take_along_axis(column, rows, 0) for column in columns)


def log_likelihood(posterior: Posterior, weights: Float[Array, "N"]) -> Float[Array, ""]:
    """Compute the weighted log-likelihood of the cloud under the mixture of `posterior`."""
    return jnp.sum(weights * posterior.log_density)


def update_sigma(
    posterior: Posterior, squared_distances: Float[Array, "N C"], weights: Float[Array, "N"]
) -> Float[Array, ""]:
    """Compute the standard deviation of largest expected likelihood, metres: `sigma^2 = sum w p d^2 / (3 sum
    w p)`.

    This is the second step of the conditional maximisation (Kineben, section 3.3.2). `squared_distances (N,
    C)` are those after the pose has moved. Without any inlier it is not finite.
    """
    share = weights[:, None] * posterior.weights
    squared = jnp.where(share > 0, squared_distances, 0.0)
    return jnp.sqrt(jnp.sum(share * squared) / (3 * jnp.sum(share)))


def update_priors(posterior: Posterior, weights: Float[Array, "N"], num_parts: int) -> Float[Array, "K"]:
    """Compute each part's share of the inliers, `(K,)`: the priors of largest expected likelihood."""
    share = weights[:, None] * posterior.weights
    of_part = jnp.zeros(num_parts, share.dtype).at[posterior.parts].add(share)
    return of_part / jnp.sum(of_part)
