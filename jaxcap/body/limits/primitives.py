"""The implicit surface of spherical primitives (Limits, eq. 2), and how far a point is outside."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

#: `iso` and `k` of the paper
LEVEL, STIFFNESS = 7.0, 20.0
#: sharpness of the smooth minimum over primitives, in the units of `k d`: small, so that thousands
#: of primitives on one place count as one
SHARPNESS = 0.2


class Primitives(NamedTuple):
    """Spheres whose fields add up; the surface is where the sum is `level`. Lengths are in those of
    the space but for `stiffness`, which counts in multiples of `unit`."""

    centres: Float[Array, "N 3"]
    thickness: Float[Array, "N"]
    unit: Float[Array, ""] | float
    level: Float[Array, ""] | float = LEVEL
    stiffness: Float[Array, ""] | float = STIFFNESS


def excess(primitives: Primitives, point: Float[Array, "3"]) -> Float[Array, "N"]:
    """`k (d - e)` of every primitive: what its field is a function of."""
    squared = jnp.sum((point - primitives.centres) ** 2, -1)
    # at a centre the slope, of which there is none, is taken as zero
    at = squared > 0
    distance = jnp.where(at, jnp.sqrt(jnp.where(at, squared, 1.0)), 0.0)
    return primitives.stiffness / primitives.unit * (distance - primitives.thickness)


def field(primitives: Primitives, point: Float[Array, "3"]) -> Float[Array, ""]:
    """`F` of eq. 2: linear inside of a primitive's thickness, quadratic to the cut-off at `2 / k` beyond."""
    x = excess(primitives, point)
    return jnp.sum(_local(x))


def signed_distance(primitives: Primitives, point: Float[Array, "3"]) -> Float[Array, ""]:
    """About how far a point is outside of the surface: `(iso - F + q) / k`, less than zero inside.

    Beyond the cut-off the paper's field is flat and shows no way back. `q` is zero within the
    thickness of the nearest primitive, goes on as `x^2 / 4` with its excess `x` up to 2 and as
    `x - 1` further out, which makes of a single primitive one straight line, `F - q = 1 - x`, for
    `(x - 2)^2 / 4 - x^2 / 4 = 1 - x`. The minimum over primitives is a smooth one, so value and
    slope are continuous where the nearest one changes.
    """
    x = excess(primitives, point)
    nearest = jnp.maximum(-SHARPNESS * jax.nn.logsumexp(-x / SHARPNESS), 0.0)
    onwards = jnp.where(nearest < 2.0, nearest**2 / 4.0, nearest - 1.0)
    return (primitives.level - jnp.sum(_local(x)) + onwards) * primitives.unit / primitives.stiffness


def radii(primitives: Primitives) -> Float[Array, "N"]:
    """How far around its centre each primitive alone reaches the level."""
    return primitives.thickness - (primitives.level - 1.0) * primitives.unit / primitives.stiffness


def _local(x: Float[Array, "N"]) -> Float[Array, "N"]:
    return jnp.where(x < 0, 1.0 - x, jnp.where(x < 2.0, (x - 2.0) ** 2 / 4.0, 0.0))
