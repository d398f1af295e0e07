"""Choice of the weight of the shape prior by cross-validation over frames."""

from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from ...arguments import checked
from ...body.body import Body, pose_body
from ...body.pose import Pose
from ...energy.data.pairs import PairDistances, PointPairs
from .shape_prior import ShapePrior
from .vertex_adaptation import adapt_shape


@checked
def choose_shape_weight(
    body: Body, poses: Pose, pairs: PointPairs, prior: ShapePrior, weights: Sequence[float]
) -> float:
    """Choose the weight of the shape prior with which vertices adapted to half of the frames are nearest to the points of the others.

    Noise calls for more smoothness: the weight is the ratio of the variance of points to that of the Laplacian vectors of
    people around those of the prior. Every other frame is left out. A single frame has the least weight.

    **Arguments:** `poses` and `pairs` stacked over frames; `weights` in ascending order. The search ends at the first weight
    that is worse than the one before.
    """
    out = jnp.arange(len(poses.rotations)) % 2 == 1
    if len(weights) == 1 or not out.any():
        return weights[0]
    # all frames remain, so that shapes of arrays do
    fitted, left = _keep(pairs, ~out), _keep(pairs, out)
    best, least = weights[0], float("inf")
    for weight in weights:
        error = float(_squared_distances(adapt_shape(body, poses, fitted, prior, weight), poses, left))
        if not error < least:
            break
        best, least = weight, error
    return best


def _keep(pairs: PointPairs, kept: Bool[Array, "F"]) -> PointPairs:
    return eqx.tree_at(lambda p: p.weights, pairs, jnp.where(kept[:, None], pairs.weights, 0))


@eqx.filter_jit
def _squared_distances(body: Body, poses: Pose, pairs: PointPairs) -> Float[Array, ""]:
    def of_frame(frame):
        pose, own = frame
        return jnp.sum(PairDistances(own).residual(pose_body(body, pose)) ** 2)

    return jnp.sum(jax.lax.map(of_frame, (poses, pairs)))
