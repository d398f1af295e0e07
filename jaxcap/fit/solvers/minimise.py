"""Minimisation of a sum of squares over a manifold with any of the solvers here."""

import abc
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import optimistix as optx
from jaxtyping import Array, Float, Int

from ...arguments import check_fields
from ...errors import InputError
from .least_squares_problem import AbstractProblem
from .single_chart import FlatProblem

#: length of the energy history if the number of steps is not given
HISTORY_LENGTH = 256
#: number of successive charts for solvers without manifolds
NUM_CHARTS = 4


class AbstractManifoldSolver(optx.AbstractLeastSquaresSolver):
    """A least-squares solver that moves by `AbstractProblem.retract`.

    It takes an `AbstractProblem` as `args`, ignores `fn`, and stores the energy after each step in
    `stats["history"]`, one for each allowed step, NaN beyond the last. optimistix's own solvers add a step to
    the unknown, which leaves the manifold.
    """

    @property
    @abc.abstractmethod
    def needs_jacobian(self) -> bool:
        """True if the solver needs all rows of the Jacobian."""

    @property
    @abc.abstractmethod
    def handles_constraints(self) -> bool:
        """True if steps obey the bounds and equalities of a problem."""

    def __check_init__(self):
        check_fields(self)


class Minimum(eqx.Module):
    """The result of a solver."""

    y: Any
    #: `|r|^2` after each step, NaN beyond the last; of solvers in charts, after each chart
    history: Float[Array, "H"]
    num_steps: Int[Array, ""]
    #: `RESULTS.successful`, or the reason for stopping before convergence
    result: optx.RESULTS
    #: the damping of the next step; one if the solver has none
    damping: Float[Array, ""]
    #: largest absolute component of the last accepted step, infinite if there was none
    length: Float[Array, ""]


#: a solver of this package, or a solver of optimistix that adds steps to a flat array
AnySolver = AbstractManifoldSolver | optx.AbstractLeastSquaresSolver | optx.AbstractMinimiser


def minimise(
    problem: AbstractProblem,
    start: Any,
    solver: AnySolver,
    max_steps: int,
    damping: float | Float[Array, ""] | None = None,
) -> Minimum:
    """Minimise `|r|^2` from a start near the minimum.

    It has no derivatives; `implicit_minimum` defines those of a minimum.

    **Arguments:** `solver`, one of this package or any of optimistix's, which works in `NUM_CHARTS` successive
    charts, each centred at the last result; the steps are shared among them. `damping` of the first step, in
    place of the solver's own: pass that of an earlier `Minimum` to continue from there.

    **Raises:** `InputError` for another type of solver, for a solver that needs all rows of the Jacobian
    where a problem has none, for one that ignores constraints where a problem has some, and where it is
    differentiated.
    """
    _check_solver(problem, solver)
    return _minimise_by(problem, start, solver, max_steps, damping)


@eqx.filter_custom_jvp
def _minimise_by(problem, start, solver: AnySolver, max_steps: int, damping) -> Minimum:
    # sums of squares are differences of large numbers, for which accelerators otherwise use fewer digits
    with jax.default_matmul_precision("highest"):
        if not isinstance(solver, AbstractManifoldSolver):
            return _minimise_flat(problem, start, solver, max_steps)
        return _minimise(problem, start, solver, max_steps, damping)


@_minimise_by.def_jvp
def _refuse_derivative(primals, tangents):
    raise InputError(
        "the steps of this fit have no derivatives; differentiate `solve`, `solve_sequence`, `solve_calibration` or "
        "`solve_joints`, which have those of the minimum."
    )


def _minimise(problem, start, solver: AbstractManifoldSolver, max_steps: int, damping) -> Minimum:
    found = optx.least_squares(
        lambda y, problem: problem.value(y),
        solver,
        start,
        args=problem,
        options={"history": max_steps} | ({} if damping is None else {"damping": damping}),
        max_steps=max_steps,
        throw=False,
    )
    stats = found.stats
    one = jnp.ones_like(stats["history"][0])
    last = stats.get("damping", one), stats.get("length", jnp.inf * one)
    return Minimum(found.value, stats["history"], stats["num_steps"], found.result, *last)


def _check_solver(problem: AbstractProblem, solver: Any) -> None:
    if not isinstance(solver, AnySolver):
        raise InputError(
            f"{type(solver).__name__} is not a least-squares solver; give LevenbergMarquardt(), or a "
            "least-squares solver or minimiser of optimistix."
        )
    manifold = isinstance(solver, AbstractManifoldSolver)
    if manifold and solver.handles_constraints:
        return
    name, constraint = type(solver).__name__, problem.describe_constraints()
    if constraint is not None:
        raise InputError(
            f"{name} does not support constraints, but the problem has {constraint}; use "
            "LevenbergMarquardt()."
        )
    needs_rows = solver.needs_jacobian if manifold else not isinstance(solver, optx.AbstractMinimiser)
    if needs_rows and not hasattr(problem, "linearise" if manifold else "residual"):
        raise InputError(
            f"{name} needs the whole Jacobian, which {type(problem).__name__} does not compute; use "
            "LevenbergMarquardt() or a minimiser such as optimistix.BFGS."
        )


def _minimise_flat(problem: AbstractProblem, start: Any, solver: Any, max_steps: int) -> Minimum:
    squares, charts = isinstance(solver, optx.AbstractLeastSquaresSolver), min(NUM_CHARTS, max_steps)

    def in_chart(y, _):
        flat = FlatProblem(problem, y)
        run: Any = optx.least_squares if squares else optx.minimise
        function = (lambda d, flat: flat.residual(d)) if squares else (lambda d, flat: flat.value(d))
        found = run(function, solver, flat.start, args=flat, max_steps=max_steps // charts, throw=False)
        y = flat.to_manifold(found.value)
        return y, (2.0 * problem.value(y), found.stats["num_steps"], found.result)

    y, (values, steps, results) = jax.lax.scan(in_chart, start, length=charts)
    last = jax.tree.map(lambda leaf: leaf[-1], results)
    return Minimum(y, values, jnp.sum(steps), last, jnp.ones_like(values[0]), jnp.inf * values[0])


def take_step(
    problem: AbstractProblem, y: Any, descent: optx.AbstractDescent, damping: float | Float[Array, ""]
) -> Any:
    """Take one damped step from `y` without testing its energy; none if its equations cannot be solved.

    Differentiable by every array of the problem.
    """
    with jax.default_matmul_precision("highest"):
        info = problem.information(y)
    zero = jax.tree.map(jnp.zeros_like, problem.scales())
    state = descent.query(zero, info, descent.init(zero, info))
    step, _ = descent.step(1.0 / jnp.asarray(damping, info.as_min().dtype), state)
    solved = jnp.stack([jnp.isfinite(leaf).all() for leaf in jax.tree.leaves(step)]).all()
    step = jax.tree.map(lambda leaf: jnp.where(solved, leaf, 0.0), step)
    return problem.retract(y, jax.tree.map(jnp.multiply, problem.scales(), step))
