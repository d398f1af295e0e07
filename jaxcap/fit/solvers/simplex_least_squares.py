"""Least squares over the simplex, exactly and for many small problems at once.

Skinning weights are at least zero and sum to one. The weights `w` of a vertex that blends `K` images are
optimal at the minimum of

    w^T G w - 2 b^T w    over    w >= 0,  sum w = 1,

with `G` the Gram matrix of the images and `b` their products with the target. Projected gradients converge
slowly for bones that move nearly alike, as neighbouring bones do. An active-set method (Nocedal and Wright,
Numerical Optimization, algorithm 16.3) ends after a few exact solves and needs no projection.
"""

import functools

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from ..linear_solvers.gauss_jordan import gauss_jordan_solve


@functools.partial(jax.jit, static_argnames="groups")
def simplex_least_squares(
    gram: Float[Array, "N K K"],
    linear: Float[Array, "N K"],
    start: Float[Array, "N K"],
    allowed: Bool[Array, "N K"] | None = None,
    groups: tuple[int, ...] | None = None,
) -> Float[Array, "N K"]:
    """Minimise `w^T gram w - 2 linear . w` over the simplex in each of `N` problems.

    **Arguments:** `gram (N, K, K)` is positive semidefinite; `linear (N, K)`; `start (N, K)` are initial
    weights on the simplex: fewer solves are needed close to the solution; `allowed` marks the weights that
    may be nonzero (as those of `start` are); `groups` are K numbers from zero: the weights of each group sum
    to one. By default all weights are one group.

    The objective never exceeds that of `start`, except for rounding. If images coincide, one of the equal
    solutions is returned.
    """
    groups = groups or (0,) * gram.shape[-1]
    sums = jnp.asarray(np.equal.outer(np.arange(max(groups) + 1), groups), gram.dtype)
    # batch last: each step of an elimination is then one long loop over it
    gram, linear, start = jnp.moveaxis(gram, 0, -1), linear.T, jnp.maximum(start, 0.0).T
    free = jnp.ones(linear.shape, bool) if allowed is None else allowed.T
    return _active_set(gram, linear, start, free, sums).T


def largest_weights(weights: Float[Array, "N K"], count: int) -> Bool[Array, "N K"]:
    """Mark the `count` largest weights of each row, as `allowed` of `simplex_least_squares`."""
    rank = jnp.argsort(jnp.argsort(-weights, axis=1, stable=True), axis=1)
    return rank < count


def _active_set(gram, linear, start, free, sums):
    count = linear.shape[0]
    epsilon = jnp.finfo(linear.dtype).eps
    size = jnp.einsum("iin->in", gram)
    # a ridge proportional to each column keeps the precision of small columns next to large ones
    ridge = 4 * epsilon * size + epsilon**2 * jnp.sum(size, 0) + jnp.finfo(linear.dtype).tiny ** 0.75
    eye = jnp.eye(count, dtype=linear.dtype)[:, :, None]

    def step(carry):
        weights, support, entered, done, turn = carry
        pairs = support[:, None] & support[None]
        matrix = jnp.where(pairs, gram, 0.0) + eye * jnp.where(support, ridge, 1.0)
        sides = jnp.concatenate(
            [jnp.where(support, linear, 0.0)[:, None], jnp.where(support[:, None], sums.T[:, :, None], 0.0)],
            1,
        )
        solved = gauss_jordan_solve(matrix, sides)
        plain, reach = solved[:, 0], solved[:, 1:]
        surplus = jnp.einsum("gk,kn->gn", sums, plain) - 1.0
        # Lagrange multipliers of the sums, by the Schur complement
        multipliers = gauss_jordan_solve(jnp.einsum("gk,khn->ghn", sums, reach), surplus[:, None])[:, 0]
        goal = plain - jnp.einsum("kgn,gn->kn", reach, multipliers)
        # move towards the goal until a weight reaches zero
        falls = support & (goal < 0.0)
        room = jnp.where(falls, weights / jnp.where(falls, weights - goal, 1.0), jnp.inf)
        share = jnp.minimum(1.0, jnp.min(room, 0))
        moved = jnp.where(support, jnp.maximum(weights + share * (goal - weights), 0.0), 0.0)
        blocked = falls & (room <= share)
        moved = jnp.where(blocked, 0.0, moved)
        arrived = ~jnp.any(falls, 0)
        # at the goal, add a weight whose increase lowers the objective
        pull = jnp.einsum("ijn,jn->in", gram, moved)
        slope = pull - linear + jnp.einsum("gk,gn->kn", sums, multipliers)
        noise = 16 * epsilon * (jnp.abs(linear) + jnp.abs(pull))
        entering = free & ~support & (slope < -noise)
        depth = jnp.where(entering, slope / jnp.sqrt(size + ridge), jnp.inf)
        best = jnp.argmin(depth, 0)
        enters = arrived & jnp.any(entering, 0)
        chosen = enters & (jnp.arange(count)[:, None] == best)
        # a weight that leaves right after it entered is a tie within rounding
        tie = jnp.any(blocked & entered, 0)
        kept = (support & ~blocked) | chosen
        settled = done | (arrived & ~enters) | tie
        return (
            jnp.where(done, weights, moved),
            jnp.where(settled, support & ~blocked, kept),
            chosen,
            settled,
            turn + 1,
        )

    def unfinished(carry):
        return ~jnp.all(carry[3]) & (carry[4] < 3 * count + 10)

    none = jnp.zeros(start.shape, bool)
    begin = (start, start > 0.0, none, jnp.zeros(start.shape[1:], bool), 0)
    weights = jax.lax.while_loop(unfinished, step, begin)[0]
    return weights / (sums.T @ (sums @ weights))
