"""Gauss-Newton with step halving (Kineben, algorithm 1), on a manifold."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import optimistix as optx
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Bool, Float, Int, PyTree

from ..linear_solvers.cholesky import factorise
from .least_squares_problem import AbstractProblem
from .minimise import HISTORY_LENGTH, AbstractManifoldSolver


class GaussNewtonState(eqx.Module):
    """The state between steps; `history` is the energy after each step, NaN beyond the last."""

    energy: Float[Array, ""]
    num_steps: Int[Array, ""]
    terminate: Bool[Array, ""]
    #: true if the equations of the last step could be solved
    solved: Bool[Array, ""]
    history: Float[Array, "H"]


class GaussNewton(AbstractManifoldSolver):
    """Kineben's own solver: `d* = -(J^T J + damping I)^-1 J^T r`, then `d*`, `d*/2`, `d*/4` and so on, until
    the energy falls (Kineben, eq. 5 and algorithm 1).

    The paper's loop never ends if no step helps; here `max_halvings` ends it, and the solver stops. `damping`
    is the small constant of the paper on the diagonal. If it is too small for the equations to be solved, the
    result is `RESULTS.singular`.
    """

    rtol: float = 1e-5
    atol: float = 1e-6
    damping: float = 1e-6
    max_halvings: int = 12
    norm: Callable[[PyTree], Array] = optx.max_norm

    @property
    def needs_jacobian(self):
        return True

    @property
    def handles_constraints(self):
        return False

    def init(self, fn, y, args: Any, options, f_struct, aux_struct, tags):
        del fn, f_struct, aux_struct, tags
        energy, length = energy_of(args, y), options.get("history", HISTORY_LENGTH)
        return GaussNewtonState(
            energy, jnp.array(0), jnp.array(False), jnp.array(True), jnp.full(length, jnp.nan, energy.dtype)
        )

    def step(self, fn, y, args: Any, options, state: GaussNewtonState, tags):
        del fn, options, tags
        units, unravel = ravel_pytree(args.scales())
        residual, jacobian = args.linearise(y)
        full, solved = damped_step(residual, jacobian, self.damping * jnp.ones_like(units))
        full = jnp.where(solved, full, 0.0)

        def too_high(carry):
            _, energy, halvings = carry
            # written so that a NaN energy counts as too high
            return ~(energy < state.energy) & (halvings < self.max_halvings)

        def halve(carry):
            share, _, halvings = carry
            return share / 2, energy_of(args, args.retract(y, unravel(share / 2 * full))), halvings + 1

        one = jnp.ones((), full.dtype)
        start = one, energy_of(args, args.retract(y, unravel(full))), jnp.array(0)
        share, energy, _ = jax.lax.while_loop(too_high, halve, start)
        better = energy < state.energy
        step = jnp.where(better, share * full, 0.0)
        energy = jnp.where(better, energy, state.energy)
        flat = state.energy - energy <= self.rtol * state.energy
        state = GaussNewtonState(
            energy=energy,
            num_steps=state.num_steps + 1,
            terminate=~better | flat | (self.norm(step) < self.atol),
            solved=solved,
            history=state.history.at[state.num_steps].set(energy, mode="drop"),
        )
        return args.retract(y, unravel(step)), state, None

    def terminate(self, fn, y, args, options, state, tags):
        del fn, y, args, options, tags
        good, unsolved, bad = optx.RESULTS.successful, optx.RESULTS.singular, optx.RESULTS.nonfinite
        # optimistix inherits this result from lineax, which pyright does not follow
        result = optx.RESULTS.where(state.solved, good, unsolved)  # pyright: ignore[reportArgumentType]
        return state.terminate, optx.RESULTS.where(jnp.isfinite(state.energy), result, bad)

    def postprocess(self, fn, y, aux, args, options, state, tags, result):
        del fn, args, options, tags, result
        return y, aux, {"history": state.history}


def energy_of(problem: AbstractProblem, y) -> Float[Array, ""]:
    """Compute `|r|^2` at `y`."""
    return 2.0 * problem.value(y)


def damped_step(
    residual: Float[Array, "R"], jacobian: Float[Array, "R D"], damping: Float[Array, "D"]
) -> tuple[Float[Array, "D"], Bool[Array, ""]]:
    """Compute `-(J^T J + diag(damping))^-1 J^T r` by Cholesky (Kineben, eq. 5), and whether it is finite.

    The matrix is first scaled to a unit diagonal, so that float32 loses no digits to units, and a bound of
    the rounding error is added to the diagonal. If rounding errors exceed it, the step is NaN.
    """
    with jax.default_matmul_precision("highest"):
        normal, side = jacobian.T @ jacobian + jnp.diag(damping), jacobian.T @ residual
    factor = factorise(normal, 10 * float(jnp.finfo(normal.dtype).eps))
    step = -factor.solve(side)
    return step, jnp.isfinite(step).all()
