"""Outer iterations: a problem is rebuilt at each result, such as with new pairs or weights."""

import logging
import math
from collections.abc import Callable, Iterable
from typing import Any, NamedTuple, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array, Float, Int

from .solvers.least_squares_problem import AbstractProblem
from .solvers.levenberg_marquardt import LevenbergMarquardt
from .solvers.minimise import minimise

_DONE, _UNFINISHED = optx.RESULTS.successful, optx.RESULTS.nonlinear_max_steps_reached
State = TypeVar("State", bound=tuple)
_LOG = logging.getLogger(__name__)

#: damping above which steps are too short to be informative
MAX_DAMPING = 1e3


class AlternationResult(NamedTuple):
    """The best result of all rounds."""

    y: Any
    #: the problem built there
    problem: Any
    #: its `|r|^2 / 2`
    value: float
    #: that of each round's start
    history: tuple[float, ...]


def alternate(
    make_problem: Callable[[Any], AbstractProblem],
    start: Any,
    solver: LevenbergMarquardt,
    *,
    rounds: int,
    steps: int = 1,
    min_gain: float = 0.0,
    patience: int = 0,
) -> AlternationResult:
    """Build a problem, take steps on it, and repeat, each round from the end of the last.

    **Arguments:** `make_problem(y)` builds the problem at `y`, always of the same shapes. There are `rounds`
    of `steps` each. A new problem may have a higher value than the last one at its end: the rounds end after
    `patience` rounds in a row that do not improve on the best by a share `min_gain`. The best is kept.
    """
    y, best, worse, history, lowered = _strongly_typed(start), None, 0, [], math.inf
    damping = jnp.asarray(solver.damping, float)
    for number in range(rounds + 1):
        problem = _strongly_typed(make_problem(y))
        value = float(_value(problem, y))
        history.append(value)
        if best is None or value < best.value:
            best = AlternationResult(y, problem, value, ())
        if value < lowered * (1 - min_gain) or not history[1:]:
            lowered, worse = value, 0
        else:
            worse += 1
        if number == rounds or worse > patience or not math.isfinite(value):
            break
        found = _improve(problem, y, solver, steps, damping)
        y, damping = found.y, found.damping
    assert best is not None
    return best._replace(history=tuple(history))


class ReweightingResult(NamedTuple):
    """The result of rounds of renewed problems."""

    y: Any
    #: the last problem; where the rounds converged, the one that `y` minimises
    problem: Any
    #: `|r|^2` after every step; a rise marks a new problem
    history: tuple[float, ...]
    #: true if the last renewal hardly changed the problem, and the solver was able to step
    converged: bool


def minimise_reweighted(
    problem: AbstractProblem,
    start: Any,
    update: Callable[[int, Any, Any], tuple[Any, Any, bool]],
    tolerance: Callable[[int], float],
    solver: LevenbergMarquardt,
    *,
    rounds: int,
    steps: int,
    max_steps: int,
) -> ReweightingResult:
    """Minimise a problem, renew its weights, and repeat until they hardly change.

    Energies of successive problems are not comparable, as in fits with estimated variances.

    **Arguments:** `update(number, problem, y)` makes the next problem and start from the round's minimum, and
    returns whether these have settled; `tolerance(number)` is the share of the energy that a round's last
    step gains; `rounds` of `steps` at most, `max_steps` steps in all.
    """
    y, history, settled = start, [], False
    for number in range(1, rounds + 1):
        problem, y = _strongly_typed((problem, y))
        this = eqx.tree_at(lambda s: s.rtol, solver, jnp.asarray(tolerance(number), float))
        found = _improve(problem, y, this, steps, jnp.asarray(solver.damping, float))
        if not history:
            history.append(float(2.0 * _value(problem, y)))
        passed = np.asarray(found.history)
        history.extend(float(value) for value in passed[np.isfinite(passed)])
        _LOG.info(
            "fitting all frames together, round %d, %d of at most %d steps", number, len(history), max_steps
        )
        if len(history) > max_steps:
            return ReweightingResult(found.y, problem, tuple(history), False)
        solved = problem
        problem, y, settled = update(number, problem, found.y)
        if not (found.result == _DONE or found.result == _UNFINISHED):
            return ReweightingResult(y, problem, tuple(history), False)
        if settled:
            return ReweightingResult(found.y, solved, tuple(history), True)
    return ReweightingResult(y, problem, tuple(history), False)


def anneal_problem(
    make_problem: Callable[[Any, Any], AbstractProblem],
    start: Any,
    solver: LevenbergMarquardt,
    stages: Iterable[Any],
    *,
    steps: int = 1,
) -> Any:
    """Take `steps` on the problem of each stage, such as each of the decreasing scales of robust weights.

    `make_problem(y, stage)` builds the problem of a stage. Each stage starts from the end of the last. Values
    of different problems are not compared: the last point is the result.
    """
    y, damping = _strongly_typed(start), jnp.asarray(solver.damping, float)
    for stage in stages:
        found = _improve(_strongly_typed(make_problem(y, stage)), y, solver, steps, damping)
        y, damping = found.y, found.damping
    return y


def reweighted_least_squares(
    make_problem: Callable[[Any], AbstractProblem],
    start: Any,
    solver: LevenbergMarquardt,
    *,
    max_steps: int,
) -> tuple[Any, Int[Array, ""]]:
    """Iterate on a rebuilt problem under `jit`: iteratively reweighted least squares for one small problem of
    many.

    Build a problem by `make_problem(y)`, take one step on it, and repeat until a step meets the tolerances of
    the solver, or until steps are rejected again and again, which is the limit of the precision. Returns the
    end point and the number of steps.
    """

    def going_on(carry):
        _, damping, converged, count = carry
        return (count < max_steps) & ~converged & (damping < MAX_DAMPING)

    def improve(carry):
        y, damping, _, count = carry
        # with the precision of the step, so that what both compute is computed once
        with jax.default_matmul_precision("highest"):
            problem = make_problem(y)
        return *solver.single_step(problem, y, damping), count + 1

    dtype = jnp.result_type(*(leaf for leaf in jax.tree.leaves(start) if eqx.is_inexact_array(leaf)))
    first = start, jnp.asarray(solver.damping, dtype), jnp.array(False), jnp.array(0)
    y, _, _, count = jax.lax.while_loop(going_on, improve, first)
    return y, count


def iterate_until_converged(
    step: Callable[[State], State],
    start: State,
    max_iterations: int,
    tolerance: float,
    min_iterations: int = 1,
) -> State:
    """Iterate closed-form steps in NumPy, such as those of reweighted means, until the estimate converges.

    The estimate is the first entry of the state. It converges when it moves by less than `tolerance`, after more than
    `min_iterations` and at most `max_iterations` iterations.
    """
    state = start
    for turn in range(max_iterations):
        old, state = state, step(state)
        if turn >= min_iterations and np.abs(state[0] - old[0]).max() < tolerance:
            break
    return state


def _strongly_typed(tree: Any) -> Any:
    """Make weakly typed arrays strong: functions would compile once more for these."""
    return jax.tree.map(
        lambda leaf: leaf.astype(leaf.dtype) if getattr(leaf, "weak_type", False) else leaf, tree
    )


@eqx.filter_jit
def _value(problem: AbstractProblem, y: Any) -> Float[Array, ""]:
    return problem.value(y)


@eqx.filter_jit
def _improve(
    problem: AbstractProblem, y: Any, solver: LevenbergMarquardt, steps: int, damping: Float[Array, ""]
):
    return minimise(problem, y, solver, steps, damping)
