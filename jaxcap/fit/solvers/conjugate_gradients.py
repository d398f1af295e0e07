"""Preconditioned conjugate gradients for symmetric systems that are known by their products."""

from collections.abc import Callable
from functools import partial

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int, PyTree


def conjugate_gradients(
    product: Callable[[PyTree], PyTree],
    side: PyTree,
    precondition: Callable[[PyTree], PyTree],
    *,
    tolerance: float | Float[Array, ""],
    max_steps: int | Int[Array, ""],
) -> PyTree:
    """Solve `A x = side` for a symmetric positive definite `A`, from zero, until the residual is a share `tolerance` of the
    right side in the Euclidean norm.

    Differentiable in both modes by what `product` and `side` depend on: a derivative is one more solve. JAX's own `cg` cannot be
    transposed where only the right side is unknown, as in the derivative of a minimum.
    """
    solve = partial(_iterate, precondition=precondition, tolerance=tolerance, max_steps=max_steps)
    return jax.lax.custom_linear_solve(product, side, solve, symmetric=True)


def _iterate(product, side, *, precondition, tolerance, max_steps):
    """Iterate as Hestenes and Stiefel (1952) do."""
    enough = tolerance**2 * _dot(side, side)

    def unfinished(carry):
        _, left, _, _, count = carry
        return (_dot(left, left) > enough) & (count < max_steps)

    def step(carry):
        x, left, slope, direction, count = carry
        image = product(direction)
        length = slope / _dot(direction, image)
        x, left = _add(x, length, direction), _add(left, -length, image)
        lifted = precondition(left)
        new = _dot(left, lifted)
        return x, left, new, _add(lifted, new / slope, direction), count + 1

    lifted = precondition(side)
    start = jax.tree.map(jnp.zeros_like, side), side, _dot(side, lifted), lifted, jnp.array(0)
    return jax.lax.while_loop(unfinished, step, start)[0]


def _dot(a: PyTree, b: PyTree) -> Float[Array, ""]:
    products = [jnp.vdot(x, y) for x, y in zip(jax.tree.leaves(a), jax.tree.leaves(b), strict=True)]
    return jnp.sum(jnp.stack(products))


def _add(a: PyTree, share: Float[Array, ""], b: PyTree) -> PyTree:
    return jax.tree.map(lambda x, y: x + share * y, a, b)
