"""A problem in one chart about a point, for solvers without manifolds."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float

from .least_squares_problem import AbstractProblem


class FlatProblem(eqx.Module):
    """A problem as functions of a flat array `d (N,)`, in scaled tangents about `centre`, where `d` is zero.

    Far from zero a chart is curved, so that solvers converge slowly there: solve, take `recentred(d)`, and
    solve again from zero.
    """

    problem: AbstractProblem
    centre: Any

    @property
    def start(self) -> Float[Array, "N"]:
        """The coordinates of the centre: zeros."""
        return jnp.zeros_like(ravel_pytree(self.problem.scales())[0])

    def to_manifold(self, d: Float[Array, "N"]) -> Any:
        """Map chart coordinates to the point of the manifold."""
        scales = self.problem.scales()
        tangent = ravel_pytree(scales)[1](d)
        return self.problem.retract(self.centre, jax.tree.map(jnp.multiply, scales, tangent))

    def value(self, d: Float[Array, "N"]) -> Float[Array, ""]:
        """Compute `|r|^2 / 2`."""
        return self.problem.value(self.to_manifold(d))

    def residual(self, d: Float[Array, "N"]) -> Float[Array, "R"]:
        """Compute all residuals."""
        problem: Any = self.problem
        return problem.residual(self.to_manifold(d))

    def recentred(self, d: Float[Array, "N"]) -> "FlatProblem":
        """Make the chart about another point."""
        return FlatProblem(self.problem, self.to_manifold(d))
