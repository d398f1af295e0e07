"""Damped Newton steps on structured normal equations, within bounds and linear equalities."""

from typing import Any, cast

import equinox as eqx
import jax
import jax.numpy as jnp
import lineax as lx
import optimistix as optx
from jaxtyping import Array, Float, PyTree

from ...errors import InputError
from ..linear_solvers.structured import AbstractStructuredMatrix, StructuredCholesky, damped
from .bounded_least_squares import solve_bounded
from .equalities import Equalities


class StepConstraints(eqx.Module):
    """Constraints on a step from the point of linearisation, in scaled tangents.

    Bounds on each unknown, which may be infinite, and linear equalities of the shared unknowns, which then
    have no bounds.
    """

    low: PyTree[Array] | None = None
    high: PyTree[Array] | None = None
    equalities: Equalities | None = None


class ConstrainedInfo(optx.FunctionInfo.EvalGradHessian):
    """Value, gradient and structured Hessian, with the constraints on a step."""

    constraints: StepConstraints | None = None


class NormalDescent(optx.AbstractDescent):
    """Steps of `(H + D / step_size) d = -g`, the damped Newton step of optimistix on normal equations.

    `D` is the identity, or with `relative` the diagonal of `H` (Marquardt 1963), which needs no common scale
    of the unknowns. `ConstrainedInfo` adds bounds or linear equalities, which only `StructuredCholesky`
    supports; the solution is exact for the damped equations.
    """

    relative: bool = eqx.field(static=True, default=False)
    linear_solver: lx.AbstractLinearSolver = StructuredCholesky()

    def init(self, y: PyTree, f_info_struct: Any) -> Any:
        del y
        return _as_constrained_info(f_info_struct)

    def query(self, y: PyTree, f_info: Any, state: Any) -> Any:
        del y, state
        return _as_constrained_info(f_info)

    def step(self, step_size: Float[Array, ""], state: ConstrainedInfo) -> tuple[PyTree, optx.RESULTS]:
        share, hessian = 1.0 / step_size, cast(AbstractStructuredMatrix, state.hessian)
        if self.relative:
            matrix = damped(hessian, share)
        else:
            amounts = jax.tree.map(lambda leaf: jnp.full_like(leaf, share), hessian.diagonal())
            matrix = hessian.add_diagonal(amounts)
        side = jax.tree.map(jnp.negative, state.grad)
        return _solve(matrix, side, state.constraints, self.linear_solver), optx.RESULTS.successful


def _solve(
    matrix: AbstractStructuredMatrix,
    rhs: PyTree,
    constraints: StepConstraints | None,
    linear_solver: lx.AbstractLinearSolver,
) -> PyTree:
    equalities = None if constraints is None else constraints.equalities
    bounded = equalities is not None or (constraints is not None and constraints.low is not None)
    if bounded and not isinstance(linear_solver, StructuredCholesky):
        raise InputError(
            f"{type(linear_solver).__name__} solves equations without constraints, but this problem has bounds, fixed frames or "
            "equalities; leave out `linear_solver`."
        )
    if constraints is not None and constraints.low is not None:
        return solve_bounded(matrix, rhs, constraints.low, constraints.high, equalities)
    # not through lineax, which refuses arrays that are divided among devices
    if isinstance(linear_solver, StructuredCholesky):
        return matrix.factorise().solve(rhs, equalities)
    return lx.linear_solve(matrix, rhs, linear_solver, throw=False).value


def _as_constrained_info(info: Any) -> ConstrainedInfo:
    if isinstance(info, ConstrainedInfo):
        return info
    return ConstrainedInfo(info.f, info.grad, info.hessian)
