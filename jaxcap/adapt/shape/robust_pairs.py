"""Pairs of a body that its shape space explains, robustly (Geman and McClure 1987)."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ...arguments import checked
from ...body.body import Body, posed_vertices
from ...body.pose import Pose
from ...energy.data.pairs import PointPairs, pair_positions

#: width of the kernel in standard deviations of a frame's pairs: a pair of three deviations has a quarter of its weight
WIDTH = 3.0
#: least standard deviation of a pair's distance across the surface, metres
MIN_DEVIATION = 5e-4
#: of a normal distribution, standard deviation over median distance
_OF_MEDIAN = 1.4826


@checked
def discount_unexplained(body: Body, poses: Pose, pairs: PointPairs) -> PointPairs:
    """Reduce the weights of pairs that are far from the surface in comparison with the other pairs of their frame.

    Hair and clothes are no shape of a person. With the Charbonnier norm of `find_pairs` their pairs keep pulling at the shape
    coefficients, as each has a gradient of the same length. Here a pair at distance `d` across the surface has the weight
    `1 / (1 + (d / c)^2)^2`, whose gradient vanishes far away. The width `c` is three standard deviations, which the median
    distance of the frame's pairs gives.

    **Arguments:** `poses` and `pairs`, stacked over frames.
    """
    return eqx.tree_at(lambda p: p.weights, pairs, _discounted_weights(body, poses, pairs))


@eqx.filter_jit
def _discounted_weights(body: Body, poses: Pose, pairs: PointPairs) -> Float[Array, "F C"]:
    def of_frame(frame: tuple[Pose, PointPairs]) -> Float[Array, "C"]:
        pose, own = frame
        gaps = pair_positions(own, posed_vertices(body, pose)) - own.points
        across = jnp.abs(jnp.sum(gaps * own.normals, -1))
        median = jnp.nanmedian(jnp.where(own.weights > 0, across, jnp.nan))
        # without pairs there is no median, and all weights are zero
        width = WIDTH * jnp.maximum(_OF_MEDIAN * jnp.nan_to_num(median), MIN_DEVIATION)
        return own.weights / (1.0 + (across / width) ** 2) ** 2

    return jax.lax.map(of_frame, (poses, pairs))
