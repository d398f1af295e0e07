"""Penalty of body surface beyond a cloud that shows where the person ends."""

import itertools

import equinox as eqx
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
#: the person ends where the cloud does if the mean normal of the layer is at least so long in the direction, and if the
#: cosine of its angle to the direction is at least the second number. Over the part of a closed surface beyond a plane, the
#: mean normal is exactly in the direction of the plane's normal, by the divergence theorem. Where a cloud is cut, or seen
#: from the other side, it is not
MIN_MEAN, MIN_COSINE = 0.25, 0.9
#: distance beyond the last point that is noise, metres
TOLERANCE = 0.02
#: height of an end that is not known, metres
UNKNOWN = 1e4


class CloudExtent(AbstractVertexPenalty):
    """Distances of vertices more than `TOLERANCE` beyond the end of a cloud, in standard deviations; zero within.

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
        beyond, directions = beyond_ends(posed.vertices[self.vertices], self.heights + TOLERANCE)
        value, rate = linear_beyond(jnp.maximum(beyond, 0.0))
        scale = jnp.sqrt(self.weights) / self.deviation
        rate = jnp.where(value > 0, scale * rate, 0.0)
        return scale * value, rate[:, None] * directions


@eqx.filter_jit
def extent_heights(cloud: Cloud) -> Float[Array, "K"]:
    """Compute the height of the last point along each of `DIRECTIONS`, metres; `UNKNOWN` where the person may not end there."""
    directions = jnp.asarray(DIRECTIONS, cloud.points.dtype)
    used = (cloud.weights > 0)[:, None]
    heights = jnp.where(used, cloud.points @ directions.T, -UNKNOWN)
    last = jnp.max(heights, 0)
    layer = (used & (heights > last - LAYER)).astype(heights.dtype)
    mean = layer.T @ cloud.normals / jnp.maximum(jnp.sum(layer, 0), 1.0)[:, None]
    along, length = jnp.sum(mean * directions, 1), jnp.linalg.norm(mean, axis=1)
    return jnp.where((along >= MIN_MEAN) & (along >= MIN_COSINE * length), last, UNKNOWN)


def beyond_ends(
    vertices: Float[Array, "C 3"], heights: Float[Array, "K"]
) -> tuple[Float[Array, "C"], Float[Array, "C 3"]]:
    """Compute how far each vertex is beyond the ends, metres, at most zero within them, and the direction in which it is farthest."""
    directions = jnp.asarray(DIRECTIONS, heights.dtype)
    beyond = vertices @ directions.T - heights
    return jnp.max(beyond, 1), directions[jnp.argmax(beyond, 1)]
