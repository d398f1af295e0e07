"""Linear equations that a least-squares step keeps exactly."""

from collections.abc import Callable

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float


class Equalities(eqx.Module):
    """Linear equations `rows s = values` of the shared unknowns, or of all of them where nothing is shared; they may depend
    on each other."""

    rows: Float[Array, "C S"]
    values: Float[Array, "C"]

    def least_change(self) -> Float[Array, "S"]:
        """Find the shortest `s` that keeps them."""
        return jnp.linalg.lstsq(self.rows, self.values)[0]


def keep_equalities(
    solve: Callable[[Array], Array], free: Float[Array, "S"], equalities: Equalities | None
) -> Float[Array, "S"]:
    """Move the unconstrained solution `free` of `A s = side` to the least of `s^T A s / 2 - side^T s` that keeps equations,
    where `solve` solves with `A`."""
    if equalities is None or len(equalities.rows) == 0:
        return free
    rows = equalities.rows
    answers = solve(rows.T)
    return free - answers @ jnp.linalg.lstsq(rows @ answers, rows @ free - equalities.values)[0]
