"""Clothes and hair: for each part a share of points that lie outside of the skin, at an offset with a deviation of its own.

The skin of a part is not what a scan shows where a skirt, a coat or hair covers it. These points belong to the part, but
hardly determine its place. So each part of the mixture (Kineben, eq. 20) has a second normal distribution, outside of the
skin along its normals. Its share, offset and deviation are learned while tracking, slowly, and within bounds.
"""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from ...body.body import Body
from ...observe.clouds import Cloud

#: at the start: share of clothes in the points of a part; offset from the skin and deviation, as shares of the body's size
FIRST_SHARE, FIRST_OFFSET, FIRST_DEVIATION = 0.05, 0.028, 0.03
#: least distance of clothes from the skin, as a share of their offset
MIN_DISTANCE_SHARE = 0.3
#: share of clothes from which a part counts as covered by them, and share above which it counts fully
COVERED, FULLY_COVERED = 0.12, 0.25
#: deviations beyond the offset that clothes may reach
MAX_DEVIATIONS = 4.0


class Clothes(eqx.Module):
    """Clothes of each of K parts."""

    #: share of the points of a part that are clothes
    share: Float[Array, "K"]
    #: distance from the skin along its normals, metres
    offset: Float[Array, "K"]
    #: standard deviation of the points from the surface at this offset, metres
    deviation: Float[Array, "K"]
    #: number of frames that they were learned from
    frames: Float[Array, ""]

    @property
    def covered(self) -> Float[Array, "K"]:
        """The degree, zero to one, to which each part counts as covered by clothes; few points may have other causes."""
        return jnp.clip((self.share - COVERED) / (FULLY_COVERED - COVERED), 0.0, 1.0)

    @property
    def extent(self) -> Float[Array, "K"]:
        """The largest distance of clothes from the skin, metres."""
        return self.offset + MAX_DEVIATIONS * self.deviation

    @property
    def worn_share(self) -> Float[Array, "K"]:
        """The share of clothes in the points of each part, zero where it is not covered."""
        return self.covered * self.share

    def spread(self, sigma: Float[Array, ""]) -> "Clothes":
        """Add the standard deviation of the skin's points, so that clothes never attract more strongly than skin."""
        return Clothes(self.share, self.offset, jnp.sqrt(self.deviation**2 + sigma**2), self.frames)


def body_size(body: Body) -> Float[Array, ""]:
    """Compute the longest side of the box around a body at rest, metres."""
    return jnp.max(jnp.max(body.vertices, 0) - jnp.min(body.vertices, 0))


def first_clothes(body: Body, num_parts: int, dtype=None) -> Clothes:
    """Make the clothes before the first frame: hardly any."""
    ones = jnp.ones(num_parts, dtype)
    size = body_size(body).astype(ones.dtype)
    return Clothes(
        FIRST_SHARE * ones, FIRST_OFFSET * size * ones, FIRST_DEVIATION * size * ones, jnp.zeros((), dtype)
    )


def clothes_allowance(clothes: Clothes) -> Float[Array, "K"]:
    """Compute the distance from the skin up to which points of a part are explained by its clothes, metres."""
    return clothes.covered * clothes.extent


def clothes_log_density(
    clothes: Clothes,
    parts: Int[Array, "N"],
    nearest: Int[Array, "N"],
    squared: Float[Array, "N"],
    vertices: Float[Array, "V 3"],
    normals: Float[Array, "V 3"],
    cloud: Cloud,
) -> tuple[Float[Array, "N"], Bool[Array, "N"]]:
    """Compute the log-density of each point in the clothes of a part, and whether the point is outside of the skin.

    It is normal about the nearest vertex, moved along its normal by the clothes' offset to the point's side of the skin, and
    minus infinity near the skin. Points inside are no clothes: they show an error of the pose.
    """
    outwards = jnp.sum((cloud.points - vertices[nearest]) * normals[nearest], 1)
    offset, deviation = clothes.offset[parts], clothes.deviation[parts]
    about = squared + offset * (offset - 2.0 * jnp.abs(outwards))
    density = -1.5 * jnp.log(2 * jnp.pi * deviation**2) - about / (2 * deviation**2)
    far = jnp.abs(outwards) > MIN_DISTANCE_SHARE * offset
    return jnp.where(far & jnp.isfinite(squared), density, -jnp.inf), outwards > 0


def clothes_reach(clothes: Clothes) -> Float[Array, "K"]:
    """Compute the distance within which clothes are searched for: zero where a part has none."""
    return jnp.where(clothes.worn_share > 0, clothes.extent, 0.0)
