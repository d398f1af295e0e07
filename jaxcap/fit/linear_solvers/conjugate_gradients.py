"""Preconditioned conjugate gradients for symmetric systems given by their matrix-vector products."""

from collections.abc import Callable
from functools import partial

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int, PyTree


def conjugate_gradients(
    matvec: Callable[[PyTree], PyTree],
    rhs: PyTree,
    precondition: Callable[[PyTree], PyTree],
    *,
    tolerance: float | Float[Array, ""],
    max_steps: int | Int[Array, ""],
    project: Callable[[PyTree], PyTree] | None = None,
    unsolved: float | None = None,
) -> PyTree:
    """Solve `A x = rhs` for a symmetric positive definite `A` by preconditioned conjugate gradients, from
    zero.

    The iteration ends when the Euclidean norm of the residual is `tolerance` times that of the right side. It
    ends earlier, with the current iterate, at a direction without positive curvature, as `A` is then not
    positive definite. `project` projects the right side onto the constraints of a constrained system. The
    result is NaN where the residual exceeds the share `unsolved`, if given, in the norm of the
    preconditioner.

    Differentiable in both modes by the dependencies of `matvec` and `rhs`: a derivative is one more solve.
    JAX's own `cg` cannot be transposed where only the right side is unknown, as in the derivative of a
    minimum.
    """
    solve = partial(
        _iterate,
        precondition=precondition,
        tolerance=tolerance,
        max_steps=max_steps,
        project=project,
        unsolved=unsolved,
    )
    return jax.lax.custom_linear_solve(matvec, rhs, solve, symmetric=True)


def _iterate(product, side, *, precondition, tolerance, max_steps, project, unsolved):
    """Iterate as in Hestenes and Stiefel (1952)."""
    side = side if project is None else project(side)
    whole = _dot(side, side)

    def unfinished(carry):
        _, left, _, _, positive, count = carry
        return (_dot(left, left) > tolerance**2 * whole) & positive & (count < max_steps)

    def step(carry):
        x, left, slope, direction, _, count = carry
        image = product(direction)
        curvature = _dot(direction, image)
        positive = curvature > 0
        length = jnp.where(positive, slope / curvature, 0.0)
        x, left = _add(x, length, direction), _add(left, -length, image)
        lifted = precondition(left)
        new = _dot(left, lifted)
        return x, left, new, _add(lifted, new / slope, direction), positive, count + 1

    lifted = precondition(side)
    zero = jax.tree.map(jnp.zeros_like, side)
    start = zero, side, _dot(side, lifted), lifted, jnp.array(True), jnp.array(0)
    x, _, slope, *_ = jax.lax.while_loop(unfinished, step, start)
    if unsolved is None:
        return x
    # written so that NaN counts as unsolved
    solved = jnp.abs(slope) <= unsolved**2 * start[2]
    return jax.tree.map(lambda leaf: jnp.where(solved, leaf, jnp.nan), x)


def _dot(a: PyTree, b: PyTree) -> Float[Array, ""]:
    products = [jnp.vdot(x, y) for x, y in zip(jax.tree.leaves(a), jax.tree.leaves(b), strict=True)]
    return jnp.sum(jnp.stack(products))


def _add(a: PyTree, share: Float[Array, ""], b: PyTree) -> PyTree:
    return jax.tree.map(lambda x, y: x + share * y, a, b)
