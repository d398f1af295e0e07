"""Levenberg-Marquardt on a manifold, put together from optimistix's parts."""

from collections.abc import Callable
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import lineax as lx
import optimistix as optx
from jaxtyping import Array, Bool, Float, Int, PyTree

from .manifold import HISTORY, AbstractManifoldSolver
from .problem import AbstractProblem

#: changes of the energy count from so many roundings of it
ROUNDINGS = 4


class SolverState(eqx.Module):
    """What a step hands to the next; `history` holds the energy after each step, NaN beyond."""

    step: PyTree[Array]
    #: of optimistix, with the Jacobian or the Hessian
    info: Any
    search_state: PyTree
    #: one over the damping
    step_size: Float[Array, ""]
    #: the length of the last step whose effect on the energy rounding hid, infinite after any other
    taken: Float[Array, ""]
    #: nothing is linearised yet
    first: Bool[Array, ""]
    num_steps: Int[Array, ""]
    terminate: Bool[Array, ""]
    result: optx.RESULTS
    history: Float[Array, "H"]


class LevenbergMarquardt(AbstractManifoldSolver):
    """Damped Gauss-Newton steps inside a classical trust region, on a manifold.

    optimistix's own solver adds a step to the unknown. This one takes an `AbstractProblem`
    as `args`, linearises `d -> r(retract(y, d))` at `d = 0`, and composes the same search
    and descent, so that no chart is ever left. A problem brings its unknowns to one
    measure (`AbstractProblem.scales`), for the damping is isotropic.

    The linear solver is Cholesky on the normal equations, 5 to 9 times faster here than
    `lx.QR()`, which may be put in its place where a problem is ill-conditioned. Problems that know their structure
    take `StructuredCholesky()`. Where equations
    cannot be solved, the damping is raised as after a step that does not help.

    The energy near a minimum is flat, so that rounding hides what steps of less than about the root of the precision change.
    Steps go on there, with the same damping, as long as each is shorter than the one before. With `rtol=0` the solver so comes
    as near to the minimum as its gradient can be computed, which derivatives of the solution need.
    """

    starting_steps: ClassVar[int] = 1

    rtol: float
    atol: float
    norm: Callable[[PyTree], Array]
    descent: optx.DampedNewtonDescent
    search: optx.ClassicalTrustRegion

    def __init__(
        self,
        rtol: float = 1e-5,
        atol: float = 1e-6,
        linear_solver: lx.AbstractLinearSolver = lx.Normal(lx.Cholesky()),
    ):
        self.rtol, self.atol, self.norm = rtol, atol, optx.max_norm
        self.descent = optx.DampedNewtonDescent(linear_solver)
        self.search = optx.ClassicalTrustRegion()

    def init(self, fn, y, args: AbstractProblem, options, f_struct, aux_struct, tags):
        del fn, options, f_struct, aux_struct, tags
        zero = jax.tree.map(jnp.zeros_like, args.scales())
        # the first step only linearises, so that this is compiled once
        info = jax.tree.map(
            lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), eqx.filter_eval_shape(args.information, y)
        )
        value = info.as_min()
        return SolverState(
            step=zero,
            info=info,
            search_state=self.search.init(zero, info),
            step_size=jnp.ones((), value.dtype),
            taken=jnp.array(jnp.inf, value.dtype),
            first=jnp.array(True),
            num_steps=jnp.array(0),
            terminate=jnp.array(False),
            result=_outcome(info, jnp.array(True)),
            history=jnp.full(HISTORY, jnp.nan, value.dtype),
        )

    def step(self, fn, y, args: AbstractProblem, options, state: SolverState, tags):
        del fn, options, tags
        first = state.first
        candidate = args.retract(y, jax.tree.map(jnp.multiply, args.scales(), state.step))
        candidate = where(first, y, candidate)
        info_there = args.information(candidate)
        step_size, accept, _, search_state = self.search.step(
            first,
            jax.tree.map(jnp.zeros_like, state.step),
            state.step,
            state.info,
            info_there,
            state.search_state,
        )
        before, after = state.info.as_min(), info_there.as_min()
        change, length = jnp.abs(before - after), self.norm(state.step)
        # the energy cannot tell here whether a step helps
        hidden = ~first & (change <= ROUNDINGS * jnp.finfo(before.dtype).eps * jnp.abs(before))
        shorter = length < state.taken
        accept = jnp.where(hidden, shorter, accept)
        search_state = where(hidden, state.search_state, search_state)
        step_size = jnp.where(hidden, state.step_size, step_size)
        # a step that is not a number is not small, and the search refuses it
        small = length < self.atol
        flat = change < self.rtol * jnp.abs(before)
        y = where(accept, candidate, y)
        info = where(accept, info_there, state.info)
        descent_state = self.descent.query(state.step, info, self.descent.init(state.step, info))
        step, _ = self.descent.step(step_size, descent_state)
        # the descent has no damping beyond this; one that was too little for a factor will not be enough
        most = step_size <= jnp.finfo(step_size.dtype).eps
        solvable = jnp.isfinite(length) | ~most
        state = SolverState(
            step=step,
            info=info,
            search_state=search_state,
            step_size=step_size,
            taken=jnp.where(hidden & shorter, length, jnp.inf),
            first=jnp.array(False),
            num_steps=jnp.where(first, 0, state.num_steps + 1),
            terminate=~first & (small | (accept & flat) | (hidden & ~shorter)),
            result=_outcome(info, solvable),
            history=state.history.at[jnp.where(first, HISTORY, state.num_steps)].set(
                2.0 * info.as_min(), mode="drop"
            ),
        )
        return y, state, None

    def terminate(self, fn, y, args, options, state, tags):
        del fn, y, args, options, tags
        return state.terminate, state.result

    def postprocess(self, fn, y, aux, args, options, state, tags, result) -> tuple[Any, Any, dict]:
        del fn, args, options, tags, result
        return y, aux, {"history": state.history, "info": state.info}


def _outcome(info, solvable: Bool[Array, ""]) -> optx.RESULTS:
    """What ends the solver: numbers that are not finite, or equations that no damping makes solvable."""
    good, unsolved, bad = optx.RESULTS.successful, optx.RESULTS.singular, optx.RESULTS.nonfinite
    # optimistix inherits this result from lineax, which pyright does not follow
    result = optx.RESULTS.where(solvable, good, unsolved)  # pyright: ignore[reportArgumentType]
    return optx.RESULTS.where(jnp.isfinite(info.as_min()), result, bad)


def where(condition: Bool[Array, ""], a: PyTree, b: PyTree) -> PyTree:
    """`a` or `b`, leaf by leaf."""
    arrays_a, rest = eqx.partition(a, eqx.is_array)
    arrays_b, _ = eqx.partition(b, eqx.is_array)
    return eqx.combine(jax.tree.map(lambda x, z: jnp.where(condition, x, z), arrays_a, arrays_b), rest)
