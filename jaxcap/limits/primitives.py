"""Implicit surfaces of spherical primitives (Limits, eq. 2), and the signed distance to them."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

#: `iso` and `k` of the paper
LEVEL, STIFFNESS = 7.0, 20.0
#: sharpness of the smooth minimum over primitives, in the units of `k d`: small, so that thousands
#: of coincident primitives count as one
SHARPNESS = 0.2


class Primitives(NamedTuple):
    """Spheres whose fields add up; the surface is where the sum is `level`.

    Lengths are in the unit of the space, but `stiffness` is per `unit`.
    """

    centres: Float[Array, "N 3"]
    thickness: Float[Array, "N"]
    unit: Float[Array, ""] | float
    level: Float[Array, ""] | float = LEVEL
    stiffness: Float[Array, ""] | float = STIFFNESS


def excess(primitives: Primitives, point: Float[Array, "3"]) -> Float[Array, "N"]:
    """Compute `k (d - e)` of every primitive, the argument of its field."""
    squared = jnp.sum((point - primitives.centres) ** 2, -1)
    # the gradient, undefined at a centre, is set to zero
    at = squared > 0
    distance = jnp.where(at, jnp.sqrt(jnp.where(at, squared, 1.0)), 0.0)
    return primitives.stiffness / primitives.unit * (distance - primitives.thickness)


def field(primitives: Primitives, point: Float[Array, "3"]) -> Float[Array, ""]:
    """Evaluate `F` of eq. 2: linear within the thickness of a primitive, quadratic up to the cut-off at
    `2 / k` beyond it."""
    x = excess(primitives, point)
    return jnp.sum(_local(x))


def signed_distance(primitives: Primitives, point: Float[Array, "3"]) -> Float[Array, ""]:
    """Compute the approximate signed distance to the surface: `(level - F + q) / stiffness`, negative inside.

    Beyond the cut-off the paper's field is constant and has no gradient, so `q` continues it. `q` is zero
    within the thickness of the nearest primitive, `x^2 / 4` up to an excess `x` of 2, and `x - 1` further
    out. For a single primitive this gives one straight line, `F - q = 1 - x`, as
    `(x - 2)^2 / 4 - x^2 / 4 = 1 - x`. The minimum over primitives is smooth, so value and gradient are
    continuous where the nearest primitive changes.
    """
    x = excess(primitives, point)
    nearest = jnp.maximum(-SHARPNESS * jax.nn.logsumexp(-x / SHARPNESS), 0.0)
    onwards = jnp.where(nearest < 2.0, nearest**2 / 4.0, nearest - 1.0)
    return (primitives.level - jnp.sum(_local(x)) + onwards) * primitives.unit / primitives.stiffness


def radii(primitives: Primitives) -> Float[Array, "N"]:
    """Compute the radius at which each primitive alone reaches the level."""
    return primitives.thickness - (primitives.level - 1.0) * primitives.unit / primitives.stiffness


def _local(x: Float[Array, "N"]) -> Float[Array, "N"]:
    return jnp.where(x < 0, 1.0 - x, jnp.where(x < 2.0, (x - 2.0) ** 2 / 4.0, 0.0))
