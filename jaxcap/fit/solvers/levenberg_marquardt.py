"""Levenberg-Marquardt on a manifold, composed of optimistix's parts."""

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import lineax as lx
import optimistix as optx
from jaxtyping import Array, Bool, Float, Int, PyTree

from ...arguments import describe
from ...errors import InputError
from ..linear_solvers.structured import StructuredCholesky
from .descent import NormalDescent
from .least_squares_problem import AbstractNestedProblem, AbstractProblem
from .minimise import HISTORY_LENGTH, AbstractManifoldSolver

#: changes of the energy count if they exceed this many roundings of it
ENERGY_ROUNDINGS = 4
#: a gain counts as nothing below this power of the precision, as a share of the energy
GAIN_EXPONENT = 0.75
#: roundings of the unknowns, relative to their measure, up to which a step counts as rounding
STEP_ROUNDINGS = 10
#: linear solvers that get the rows of the Jacobian, not the normal equations
LEAST_SQUARES = lx.QR, lx.SVD, lx.LSMR, lx.Normal, lx.AutoLinearSolver


class SolverState(eqx.Module):
    """The state between steps; `history` is the energy after each step, NaN beyond the last."""

    #: optimistix's function information, with the Jacobian or the Hessian at the last point of linearisation
    info: Any
    #: true if the unknowns have moved since
    moved: Bool[Array, ""]
    search_state: PyTree
    #: one over the damping
    step_size: Float[Array, ""]
    #: length of the last step if its effect on the energy was below rounding, otherwise infinite
    hidden_length: Float[Array, ""]
    #: length of the last accepted step, infinite before any
    length: Float[Array, ""]
    terminate: Bool[Array, ""]
    num_steps: Int[Array, ""]
    result: optx.RESULTS
    history: Float[Array, "H"]


class TestedStep(NamedTuple):
    """The end of one step."""

    y: Any
    #: the damping of the next step
    damping: Float[Array, ""]
    #: true if the step met the tolerances of the solver
    converged: Bool[Array, ""]


class LevenbergMarquardt(AbstractManifoldSolver):
    """Damped Gauss-Newton steps in a classical trust region, on a manifold.

    optimistix's own solver adds a step to the unknown. This one takes an `AbstractProblem` as `args`,
    linearises `d -> r(retract(y, d))` at `d = 0`, and composes the same search with a descent, so that
    iterates stay on the manifold. A step is judged by its energy alone; the problem is linearised again only
    after an accepted step.

    A problem scales its unknowns to one measure (`AbstractProblem.scales`), because the damping is isotropic;
    with `relative` it is a share of each curvature. `damping` is that of the first step. The equations are
    solved by `StructuredCholesky` on a unit diagonal, 5 to 9 times faster here than QR. `linear_solver`
    replaces it by one of lineax: a solver for square systems, such as `lx.CG(1e-6, 1e-6)`, gets the structured
    normal equations, if steps have no constraints; a least-squares solver, such as `lx.QR()` for an
    ill-conditioned problem of one frame, gets the rows of the Jacobian. If equations cannot be solved, the
    damping is raised as after a rejected step.

    Of several `lengths` of each step the best is taken: the line search of Adaptation, 4.1.4. The iteration also ends at a step
    that changes half the energy by less than `energy_atol`, or is expected to: exact data leave nothing but rounding.

    The energy near a minimum is flat, so that rounding hides the effect of steps shorter than about the root
    of the precision. Steps go on there, with the same damping, as long as each is shorter than the one
    before. With `rtol=0` the solver therefore comes as near to the minimum as its gradient can be computed,
    which derivatives of the solution need. If the residuals themselves are roundings, as of exact data, any step may raise
    the energy. A rejected step with little damping ends the iteration if its predicted gain is at most the energy that
    rounding of the unknowns causes.
    """

    rtol: float
    atol: float
    damping: float | Float[Array, ""]
    lengths: tuple[float, ...] = eqx.field(static=True)
    energy_atol: float
    norm: Callable[[PyTree], Array]
    descent: optx.AbstractDescent
    search: optx.ClassicalTrustRegion

    def __init__(
        self,
        rtol: float = 1e-5,
        atol: float = 1e-6,
        linear_solver: lx.AbstractLinearSolver | None = None,
        damping: float | Float[Array, ""] = 1.0,
        relative: bool = False,
        lengths: tuple[float, ...] = (1.0,),
        energy_atol: float = 0.0,
    ):
        self.rtol, self.atol, self.damping, self.lengths = rtol, atol, damping, lengths
        self.energy_atol = energy_atol
        self.norm = optx.max_norm
        linear_solver = StructuredCholesky() if linear_solver is None else linear_solver
        if not isinstance(linear_solver, lx.AbstractLinearSolver):
            raise InputError(
                f"LevenbergMarquardt: `linear_solver` {describe(linear_solver)}; expected a linear solver of lineax, such as "
                "`lx.CG(1e-6, 1e-6)`."
            )
        if relative and isinstance(linear_solver, LEAST_SQUARES):
            raise InputError(
                f"LevenbergMarquardt: `relative` damps normal equations, which {type(linear_solver).__name__} does not get; "
                "leave out one of them."
            )
        self.descent = (
            optx.DampedNewtonDescent(linear_solver)
            if isinstance(linear_solver, LEAST_SQUARES)
            else NormalDescent(relative, linear_solver)
        )
        self.search = optx.ClassicalTrustRegion()

    @property
    def needs_jacobian(self):
        return not isinstance(self.descent, NormalDescent)

    @property
    def handles_constraints(self):
        return isinstance(self.descent, NormalDescent) and isinstance(
            self.descent.linear_solver, StructuredCholesky
        )

    def init(self, fn, y, args: AbstractProblem, options, f_struct, aux_struct, tags):
        del fn, f_struct, aux_struct, tags
        info = jax.tree.map(
            lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), eqx.filter_eval_shape(self._linearise, args, y)
        )
        value = info.as_min()
        step_size = 1.0 / jnp.asarray(options.get("damping", self.damping), value.dtype)
        search_state = self.search.init(jax.tree.map(jnp.zeros_like, args.scales()), info)
        return SolverState(
            info=info,
            moved=jnp.array(True),
            search_state=eqx.tree_at(lambda s: s.step_size, search_state, step_size),
            step_size=step_size,
            hidden_length=jnp.array(jnp.inf, value.dtype),
            length=jnp.array(jnp.inf, value.dtype),
            num_steps=jnp.array(0),
            terminate=jnp.array(False),
            result=optx.RESULTS.successful,
            history=jnp.full(options.get("history", HISTORY_LENGTH), jnp.nan, value.dtype),
        )

    def step(self, fn, y, args: AbstractProblem, options, state: SolverState, tags):
        del fn, options, tags
        info = _filter_cond(state.moved, lambda y: self._linearise(args, y), y, state.info)
        return *self._step_from(args, y, info, state), None

    def single_step(self, problem: AbstractProblem, y: Any, damping: Float[Array, ""]) -> TestedStep:
        """Take one step, and keep `y` where the step does not lower the energy.

        The same as `minimise` with one step, without a loop and a condition about it: a small problem that is rebuilt before
        every step is then compiled into one piece with what rebuilds it.
        """
        none: Any = None
        with jax.default_matmul_precision("highest"):
            state = self.init(none, y, problem, {"history": 1, "damping": damping}, none, none, none)
            y, state = self._step_from(problem, y, self._linearise(problem, y), state)
        return TestedStep(
            y, 1.0 / state.step_size, state.terminate & (state.result == optx.RESULTS.successful)
        )

    def _step_from(
        self, args: AbstractProblem, y: Any, info: Any, state: SolverState
    ) -> tuple[Any, SolverState]:
        zero = jax.tree.map(jnp.zeros_like, args.scales())
        descent_state = self.descent.query(zero, info, self.descent.init(zero, info))
        whole, _ = self.descent.step(state.step_size, descent_state)
        step, candidate, there = self._search_length(args, y, whole)
        step_size, accept, _, search_state = self.search.step(
            jnp.array(False), zero, step, info, there, state.search_state
        )
        before, after = info.as_min(), there.as_min()
        change, length = jnp.abs(before - after), self.norm(step)
        # here the change of the energy is below rounding
        eps = jnp.finfo(before.dtype).eps
        hidden = change <= ENERGY_ROUNDINGS * eps * jnp.abs(before)
        shorter = length < state.hidden_length
        accept = jnp.where(hidden, shorter, accept)
        search_state = tree_where(hidden, state.search_state, search_state)
        step_size = jnp.where(hidden, state.step_size, step_size)
        # a NaN step is not small, and the search rejects it; a rejected small step ends the iteration only if
        # its predicted gain is negligible
        gain = jnp.abs(info.compute_grad_dot(step))
        nothing = gain <= eps**GAIN_EXPONENT * jnp.abs(before)
        small = ((length < self.atol) & (accept | nothing)) | (gain < self.energy_atol)
        # much damping alone would make the gain as small
        rounding = (STEP_ROUNDINGS * eps) ** 2 * _total_curvature(info)
        rounded = (gain <= rounding) & (state.step_size >= 1.0)
        flat = change < self.rtol * jnp.abs(before) + self.energy_atol
        # the largest damping; if a smaller one was too little for a factor, this one is too
        most = state.step_size <= jnp.finfo(step_size.dtype).eps
        state = SolverState(
            info=info,
            moved=accept,
            search_state=search_state,
            step_size=step_size,
            hidden_length=jnp.where(hidden & shorter, length, jnp.inf),
            length=jnp.where(accept, length, state.length),
            num_steps=state.num_steps + 1,
            terminate=small | (accept & flat) | (hidden & ~shorter) | ((rounded | most) & ~accept),
            result=_outcome(before, jnp.isfinite(length) | ~most, accept | ~most),
            history=state.history.at[state.num_steps].set(
                2.0 * jnp.where(accept, after, before), mode="drop"
            ),
        )
        return tree_where(accept, candidate, y), state

    def _linearise(self, problem: Any, y: Any) -> Any:
        if not self.needs_jacobian:
            return problem.information(y)
        scales = problem.scales()
        if not eqx.is_array(scales):
            raise InputError(
                "LevenbergMarquardt: this `linear_solver` needs unknowns that are one flat array, but those of "
                f"{type(problem).__name__} are not; give one for square systems, such as `lx.CG`, or none."
            )
        residual, jacobian = problem.linearise(y)
        rows = lx.MatrixLinearOperator(jacobian * scales)
        return optx.FunctionInfo.ResidualJac(residual, rows)  # pyright: ignore[reportCallIssue]

    def _search_length(self, problem: AbstractProblem, y: Any, whole: PyTree) -> tuple[PyTree, Any, Any]:
        """Find the best length of a step, its end point, and the energy there."""

        def of(length):
            step = jax.tree.map(lambda leaf: length * leaf, whole)
            candidate = problem.retract(y, jax.tree.map(jnp.multiply, problem.scales(), step))
            if isinstance(problem, AbstractNestedProblem):
                candidate = problem.improve_nested(candidate)
            return step, candidate, problem.value(candidate)

        if len(self.lengths) == 1:
            step, candidate, value = of(self.lengths[0])
        else:
            lengths = jnp.asarray(self.lengths, jax.tree.leaves(whole)[0].dtype)
            values = jax.lax.map(lambda length: of(length)[2], lengths)
            best = jnp.argmin(jnp.where(jnp.isfinite(values), values, jnp.inf))
            step, candidate, _ = of(lengths[best])
            value = values[best]
        return step, candidate, optx.FunctionInfo.Eval(value)  # pyright: ignore[reportCallIssue]

    def terminate(self, fn, y, args, options, state, tags):
        del fn, y, args, options, tags
        return state.terminate, state.result

    def postprocess(self, fn, y, aux, args, options, state, tags, result) -> tuple[Any, Any, dict]:
        del fn, args, options, tags, result
        return y, aux, {"history": state.history, "damping": 1.0 / state.step_size, "length": state.length}


def _total_curvature(info: Any) -> Float[Array, ""]:
    """Compute the trace of the Hessian of half the energy, in scaled unknowns."""
    if isinstance(info, optx.FunctionInfo.ResidualJac):
        return jnp.sum(info.jac.as_matrix() ** 2)
    return jax.tree.reduce(jnp.add, jax.tree.map(jnp.sum, info.hessian.diagonal()))


def _outcome(value: Float[Array, ""], solvable: Bool[Array, ""], able: Bool[Array, ""]) -> optx.RESULTS:
    """Determine the result of the solver.

    It fails for an energy that is not finite, for equations that no damping makes solvable, and if the energy
    falls along no step, however short.
    """
    kinds: Any = optx.RESULTS
    result = kinds.where(able, kinds.successful, kinds.nonlinear_divergence)
    result = kinds.where(solvable, result, kinds.singular)
    return kinds.where(jnp.isfinite(value), result, kinds.nonfinite)


def _filter_cond(
    condition: Bool[Array, ""], function: Callable, argument: PyTree, otherwise: PyTree
) -> PyTree:
    """Evaluate `function(argument)` only if a condition holds."""
    arrays, rest = eqx.partition(otherwise, eqx.is_array)
    found = jax.lax.cond(
        condition, lambda x: eqx.filter(function(x), eqx.is_array), lambda _: arrays, argument
    )
    return eqx.combine(found, rest)


def tree_where(condition: Bool[Array, ""], a: PyTree, b: PyTree) -> PyTree:
    """Select `a` or `b`, leaf by leaf."""
    arrays_a, rest = eqx.partition(a, eqx.is_array)
    arrays_b, _ = eqx.partition(b, eqx.is_array)
    return eqx.combine(jax.tree.map(lambda x, z: jnp.where(condition, x, z), arrays_a, arrays_b), rest)
