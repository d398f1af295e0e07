"""Penalty of body surface beyond a cloud that shows where the person ends."""

import itertools

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ...body.body import Posed
from ...observe.clouds import Cloud
from .free_space import linear_beyond
from .vertices import AbstractVertexPenalty

#: directions in which a cloud may end: those to the sides, edges and corners of a cube
DIRECTIONS = np.array([v for v in itertools.product((-1.0, 0.0, 1.0), repeat=3) if any(v)])
DIRECTIONS = DIRECTIONS / np.linalg.norm(DIRECTIONS, axis=1, keepdims=True)
#: thickness of the layer of points at the end of a cloud, metres
LAYER = 0.03
#: the person ends where the cloud does if at least this share of the layer's points have a normal whose cosine to the
#: direction is at least this. A cloud that is cut, or seen from the other side, has no such normals there
MIN_SHARE, MIN_COSINE = 0.3, 0.5
#: distance beyond the last point that is noise, metres
TOLERANCE = 0.02
#: height of an end that is not known, metres
UNKNOWN = 1e4


class CloudExtent(AbstractVertexPenalty):
    """Distances of vertices beyond the end of a cloud, in standard deviations; zero within the cloud.

    Each vertex counts in the direction in which it is farthest beyond.
    """

    vertices: Int[Array, "C"]
    #: weight of each vertex
    weights: Float[Array, "C"]
    #: the last height along each of `DIRECTIONS`, metres; `UNKNOWN` where the cloud does not show that the person ends
    heights: Float[Array, "K"]
    #: standard deviation of a distance, metres
    deviation: Float[Array, ""]

    def rows(self, posed: Posed) -> tuple[Float[Array, "C"], Float[Array, "C 3"]]:
        directions = jnp.asarray(DIRECTIONS, self.heights.dtype)
        beyond = posed.vertices[self.vertices] @ directions.T - self.heights
        farthest = jnp.argmax(beyond, 1)
        value, rate = linear_beyond(jnp.maximum(jnp.max(beyond, 1), 0.0))
        scale = jnp.sqrt(self.weights) / self.deviation
        rate = jnp.where(value > 0, scale * rate, 0.0)
        return scale * value, rate[:, None] * directions[farthest]


def extent_heights(cloud: Cloud) -> Float[Array, "K"]:
    """Compute the height along each of `DIRECTIONS` at which the person ends in a cloud, metres; `UNKNOWN` where not shown."""
    directions = jnp.asarray(DIRECTIONS, cloud.points.dtype)
    used = (cloud.weights > 0)[:, None]
    heights = jnp.where(used, cloud.points @ directions.T, -UNKNOWN)
    last = jnp.max(heights, 0)
    layer = used & (heights > last - LAYER)
    facing = layer & (cloud.normals @ directions.T > MIN_COSINE)
    shown = jnp.sum(facing, 0) >= MIN_SHARE * jnp.sum(layer, 0)
    return jnp.where(shown, last + TOLERANCE, UNKNOWN)
