"""Optimal weights and rest position of each vertex under linear blend skinning.

Without a Laplacian term, vertices are independent of each other given poses and joints. The residual of a
vertex is bilinear in its weights on the simplex and its rest position. A Gauss-Newton step on both, with the
position eliminated, is least squares over the simplex. Along a step, the errors are an exactly known
parabola. The optimum is the fixed point of these steps.
"""

from typing import NamedTuple

import jax.numpy as jnp
import optimistix as optx
from jaxtyping import Array, Float, Int

from ...fit.linear_solvers.gauss_jordan import gauss_jordan_solve
from ...fit.solvers.simplex_least_squares import simplex_least_squares

#: the relative decrease below which the steps end; the step lengths that are tried
MIN_RELATIVE_DECREASE, LENGTHS = 1e-3, (0.0, 0.03, 0.1, 0.25, 0.5, 1.0)
#: sum of squared residuals that is larger than any, before the first step
UNKNOWN = 1e30


class OptimisedVertices(NamedTuple):
    """Optimised vertices."""

    #: weights of the bones near each vertex
    weights: Float[Array, "V K"]
    rest: Float[Array, "V 3"]
    #: sum over all vertices
    squared_residual: Float[Array, ""]


def optimise_vertices(
    weights: Float[Array, "V K"],
    rest: Float[Array, "V 3"],
    candidates: Int[Array, "V K"],
    bones: Float[Array, "F J 3 4"],
    targets: Float[Array, "V N"],
    steps: int,
) -> OptimisedVertices:
    """Optimise the weights of the bones `candidates` each vertex and its rest position, by Gauss-Newton on both.

    With the position eliminated, the weights are a least-squares problem over the simplex.

    **Arguments:** `targets` are the target positions of each vertex in all frames, 3 F numbers; `steps` is the
    most steps.
    """
    count, frames = len(rest), len(bones)
    turns = jnp.swapaxes(bones[..., :3], 0, 1).reshape(bones.shape[1], -1)

    def slopes_of(shares):
        return (expand_weights(shares, candidates, len(turns)) @ turns).reshape(count, 3 * frames, 3)

    def step(found: OptimisedVertices, _) -> OptimisedVertices:
        weights, rest, _ = found
        differences = bone_images(bones, rest, candidates) - targets[:, None]
        reduced, lift, slopes = _reduced(differences, slopes_of(weights))
        goal = simplex_least_squares(reduced @ jnp.swapaxes(reduced, 1, 2), jnp.zeros_like(weights), weights)
        change, shift = goal - weights, -jnp.einsum("vak,vk->va", lift, goal)
        errors = jnp.einsum("vk,vkn->vn", weights, differences)
        first = jnp.einsum("vk,vkn->vn", change, differences) + jnp.einsum("vna,va->vn", slopes, shift)
        second = jnp.einsum("vna,va->vn", slopes_of(change), shift)
        # bilinear: errors along the step are an exactly known parabola
        squares = jnp.stack([jnp.sum((errors + s * first + s * s * second) ** 2, 1) for s in LENGTHS])
        length = jnp.asarray(LENGTHS, rest.dtype)[jnp.argmin(squares, 0)][:, None]
        return OptimisedVertices(
            weights + length * change, rest + length * shift, jnp.sum(jnp.min(squares, 0))
        )

    start = OptimisedVertices(weights, rest, jnp.asarray(UNKNOWN, rest.dtype))
    solver = optx.FixedPointIteration(MIN_RELATIVE_DECREASE, 0.0, norm=_relative_decrease)
    weights, rest, left = optx.fixed_point(step, solver, start, max_steps=steps, throw=False).value
    return OptimisedVertices(weights / jnp.sum(weights, 1, keepdims=True), rest, left)


def _relative_decrease(change: OptimisedVertices) -> Float[Array, ""]:
    """Measure a step by the change of the sum of squared residuals alone."""
    return jnp.abs(change.squared_residual)


def choose_candidate_bones(
    weights: Float[Array, "V J"],
    rest: Float[Array, "V 3"],
    bones: Float[Array, "F J 3 4"],
    targets: Float[Array, "V N"],
    num_real: Int[Array, ""],
    num_candidates: int,
) -> Int[Array, "V K"]:
    """Choose `num_candidates` candidate bones for each vertex.

    These are the bones that move it already and, of the first `num_real` bones, those whose weight would lower
    its residual most, with the rest position adapted: as columns are priced in linear programming.
    """
    every = jnp.broadcast_to(jnp.arange(weights.shape[1]), weights.shape)
    differences = bone_images(bones, rest, every) - targets[:, None]
    turns = jnp.swapaxes(bones[..., :3], 0, 1).reshape(weights.shape[1], -1)
    reduced, _, _ = _reduced(differences, (weights @ turns).reshape(len(rest), -1, 3))
    errors = jnp.einsum("vj,vjn->vn", weights, reduced)
    towards = reduced - errors[:, None]
    falls = jnp.maximum(-jnp.einsum("vjn,vn->vj", towards, errors), 0.0)
    squares = jnp.sum(towards**2, 2)
    tiny = jnp.finfo(falls.dtype).tiny
    gains = falls**2 / (squares + tiny) - 1e-6 * squares / (jnp.max(squares, 1, keepdims=True) + tiny)
    gains = jnp.where(jnp.arange(weights.shape[1]) < num_real, gains, -jnp.inf)
    return jnp.argsort(jnp.where(weights > 0, -jnp.inf, -gains), axis=1)[:, :num_candidates]


def _reduced(differences: Float[Array, "V K N"], slopes: Float[Array, "V N 3"]):
    """Eliminate the rest position from the images.

    Returns the reduced images, the adaptation of the position to each, and the slopes.
    """
    normal = jnp.einsum("vna,vnb->abv", slopes, slopes)
    lift = jnp.moveaxis(gauss_jordan_solve(normal, jnp.einsum("vna,vkn->akv", slopes, differences)), -1, 0)
    return differences - jnp.einsum("vna,vak->vkn", slopes, lift), lift, slopes


def expand_weights(
    weights: Float[Array, "V K"], candidates: Int[Array, "V K"], count: int
) -> Float[Array, "V J"]:
    """Expand weights of the bones near each vertex to all bones."""
    rows = jnp.arange(len(weights))[:, None]
    return jnp.zeros((len(weights), count), weights.dtype).at[rows, candidates].add(weights)


def bone_images(
    bones: Float[Array, "F J 3 4"], rest: Float[Array, "V 3"], candidates: Int[Array, "V K"]
) -> Float[Array, "V K N"]:
    """Compute the positions of each vertex under the bones near it in all frames, 3 F numbers."""
    homogeneous = jnp.concatenate([rest, jnp.ones_like(rest[:, :1])], 1)
    count = bones.shape[1]
    every = (homogeneous @ bones.transpose(3, 1, 0, 2).reshape(4, -1)).reshape(len(rest), count, -1)
    return jnp.take_along_axis(every, candidates[:, :, None], 1)
