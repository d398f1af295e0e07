"""The weights and the rest place that serve each vertex of a linearly blended body best.

Without a Laplacian, vertices are independent of each other given the poses and the joints. The
squares left are bilinear in a vertex's weights on the simplex and its rest place: Gauss-Newton on
both at once, with the place eliminated, is least squares over the simplex, and along a step the
errors are a parabola that is known exactly.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..body.body import Body
from ..body.kinematics import Transforms
from ..body.pose import Pose
from ..body.skin import LinearSkin
from .hang import all_bones
from .simplex import simplex_least_squares

#: steps at most; the share of the squares below which a step is the last; lengths that are tried
STEPS, ENOUGH, LENGTHS = 20, 1e-3, (0.0, 0.03, 0.1, 0.25, 0.5, 1.0)
#: vertices of one block
BLOCK = 1024


def adapt_vertices(body: Body, poses: Pose, targets: Float[Array, "F V 3"]) -> Body:
    """The weights and the rest place that serve each vertex best, by Gauss-Newton on both at once:
    with the place eliminated, weights are least squares over the simplex."""
    return adapt(body, all_bones(body.skeleton, poses), targets)[0]


def adapt(
    body: Body, bones: Transforms, targets: Float[Array, "F V 3"], steps: int = STEPS
) -> tuple[Body, float]:
    """The body with the best weights and rest places for its bones, and the squares that are left."""
    count, size = len(body.vertices), min(BLOCK, len(body.vertices))
    aims = jnp.swapaxes(targets, 0, 1).reshape(count, -1)
    before = body.skin.influence(body.skeleton.num_joints)
    weights, rest, values = [], [], []
    for first in range(0, count, size):
        # blocks are equally long; what is in the last one twice is cut from its head
        begin = min(first, count - size)
        block = slice(begin, begin + size)
        w, v, left = _adapt_block(before[block], body.vertices[block], bones, aims[block], steps)
        weights.append(w[first - begin :])
        rest.append(v[first - begin :])
        values.append(left[first - begin :])
    skin = LinearSkin(jnp.concatenate(weights))
    body = eqx.tree_at(lambda b: (b.skin, b.vertices), body, (skin, jnp.concatenate(rest)))
    return body, float(np.sum(np.asarray(jnp.concatenate(values)), dtype=float))


@eqx.filter_jit
def _adapt_block(weights, rest, bones: Transforms, aims, steps: int):
    count, frames = len(rest), len(bones.rotations)
    turns = jnp.swapaxes(bones.rotations, 0, 1).reshape(weights.shape[1], -1)

    def slopes_of(shares):
        return (shares @ turns).reshape(count, 3 * frames, 3)

    def step(carry):
        weights, rest, _, left, number = carry
        apart = images(bones, rest) - aims[:, None]
        slopes = slopes_of(weights)
        lift = jnp.linalg.solve(
            jnp.swapaxes(slopes, 1, 2) @ slopes, jnp.swapaxes(slopes, 1, 2) @ jnp.swapaxes(apart, 1, 2)
        )
        # what is left of the images where the rest place follows
        reduced = apart - jnp.swapaxes(slopes @ lift, 1, 2)
        goal = simplex_least_squares(reduced @ jnp.swapaxes(reduced, 1, 2), jnp.zeros_like(weights), weights)
        change, shift = goal - weights, -jnp.einsum("vaj,vj->va", lift, goal)
        errors = jnp.einsum("vj,vjn->vn", weights, apart)
        first = jnp.einsum("vj,vjn->vn", change, apart) + jnp.einsum("vna,va->vn", slopes, shift)
        second = jnp.einsum("vna,va->vn", slopes_of(change), shift)
        # bilinear, so that errors along the step are a parabola, known exactly
        squares = jnp.stack([jnp.sum((errors + s * first + s * s * second) ** 2, 1) for s in LENGTHS])
        length = jnp.asarray(LENGTHS, rest.dtype)[jnp.argmin(squares, 0)][:, None]
        return weights + length * change, rest + length * shift, left, jnp.min(squares, 0), number + 1

    def unfinished(carry):
        before, left = jnp.sum(carry[2]), jnp.sum(carry[3])
        return (carry[4] < steps) & ((carry[4] < 2) | (before - left > ENOUGH * left))

    none = jnp.full(count, jnp.inf, rest.dtype)
    weights, rest, _, left, _ = jax.lax.while_loop(unfinished, step, (weights, rest, none, none, 0))
    return weights / jnp.sum(weights, 1, keepdims=True), rest, left


def images(bones: Transforms, rest: Float[Array, "V 3"]) -> Float[Array, "V J N"]:
    """Where each bone takes each vertex in all frames, 3 F numbers."""
    affine = jnp.concatenate([bones.rotations, bones.translations[..., None]], -1)
    places = jnp.concatenate([rest, jnp.ones_like(rest[:, :1])], 1)
    count = affine.shape[1]
    return (places @ affine.transpose(3, 1, 0, 2).reshape(4, -1)).reshape(len(rest), count, -1)
