"""Approximate inverses of symmetric matrices given by their products and bounds of their eigenvalues."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float


def chebyshev(
    matvec: Callable[[Array], Array],
    rhs: Array,
    low: float | Float[Array, ""],
    high: float | Float[Array, ""],
    steps: int,
) -> Array:
    """Solve `A x = rhs` approximately by Chebyshev's iteration from zero.

    The result is linear and symmetric in the right side, so that it can precondition conjugate gradients.

    **Arguments:** `low` and `high` bound the eigenvalues of `A`, above zero. **Source:** Golub and Varga
    1961.
    """
    middle, radius = (high + low) / 2, (high - low) / 2

    def step(carry, _):
        x, left, move, share = carry
        x, left = x + move, left - matvec(move)
        after = 1.0 / (2.0 * middle / radius - share)
        return (x, left, after * share * move + 2.0 * after / radius * left, after), None

    start = jnp.zeros_like(rhs), rhs, rhs / middle, radius / middle
    (x, _, move, _), _ = jax.lax.scan(step, start, length=steps)
    return x + move
