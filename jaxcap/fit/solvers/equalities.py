"""Linear equalities that a least-squares step satisfies exactly."""

from collections.abc import Callable

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float


class Equalities(eqx.Module):
    """Linear equalities `rows s = values` of the shared unknowns, or of all unknowns if none are shared.

    They may be linearly dependent.
    """

    rows: Float[Array, "C S"]
    values: Float[Array, "C"]

    def minimum_norm_solution(self) -> Float[Array, "S"]:
        """Find the shortest `s` that satisfies them."""
        return jnp.linalg.lstsq(self.rows, self.values)[0]


def enforce_equalities(
    solve: Callable[[Array], Array], unconstrained: Float[Array, "S"], equalities: Equalities | None
) -> Float[Array, "S"]:
    """Correct the solution `unconstrained` of `A s = rhs` to minimise `s^T A s / 2 - rhs^T s` subject to
    equalities.

    `solve` solves systems of `A`.
    """
    if equalities is None or len(equalities.rows) == 0:
        return unconstrained
    rows = equalities.rows
    answers = solve(rows.T)
    return (
        unconstrained
        - answers @ jnp.linalg.lstsq(rows @ answers, rows @ unconstrained - equalities.values)[0]
    )
