"""Where joints stand that no motion tells: amid the cut between the parts they join."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..body.body import Body
from ..geometry.laplacian import vertex_adjacency

#: how far a joint's centre may be from the middle of its cut, as a share of the body's diagonal
SPREAD = 0.01


class Anchors(eqx.Module):
    """A normal prior on joints' centres, in the metric of Q.

    A hinge does not tell where along its axis it stands, and a joint that hardly turns tells
    nothing: there the middle of the cut decides. Elsewhere thousands of vertices do, beside
    which the prior weighs nothing.
    """

    middles: Float[Array, "J 3"]
    #: one over a squared deviation, metres^-2, in units of the variance of a vertex; zero for roots
    #: and where the parts of a joint do not touch
    weights: Float[Array, "J"]


def cut_anchors(body: Body) -> Anchors:
    """Anchors amid the edges that lead from each joint's part to its parent's, in the rest shape."""
    labels, rest = np.asarray(body.skin.parts()), np.asarray(body.vertices, float)
    parents = np.array(body.skeleton.parents)
    adjacency = vertex_adjacency(np.asarray(body.faces), len(rest)).tocoo()
    inner, outer = adjacency.coords
    crossing = parents[labels[inner]] == labels[outer]
    inner, outer = inner[crossing], outer[crossing]
    count = np.bincount(labels[inner], minlength=len(parents))
    ends = (rest[inner] + rest[outer]) / 2
    sums = np.stack([np.bincount(labels[inner], ends[:, i], len(parents)) for i in range(3)], 1)
    deviation = SPREAD * float(np.linalg.norm(np.ptp(rest, axis=0)))
    weights = np.where(count > 0, 1.0 / deviation**2, 0.0)
    dtype = body.vertices.dtype
    return Anchors(
        jnp.asarray(sums / np.maximum(count, 1)[:, None], dtype), jnp.asarray(weights, dtype)
    )
