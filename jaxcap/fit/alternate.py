"""Outer rounds: a problem that is made anew where the last one led, such as with new pairs or weights."""

import logging
import math
from collections.abc import Callable, Iterable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array, Float, Int

from .solvers.levenberg_marquardt import LevenbergMarquardt
from .solvers.minimise import minimise
from .solvers.problem import AbstractProblem

_DONE, _UNFINISHED = optx.RESULTS.successful, optx.RESULTS.nonlinear_max_steps_reached
_LOG = logging.getLogger(__name__)

#: damping from which on steps are too short to tell anything
STUCK = 1e3


class Alternation(NamedTuple):
    """The best that the rounds have reached."""

    y: Any
    #: the problem that was made there
    problem: Any
    #: its `|r|^2 / 2`
    value: float
    #: that of each round's start
    history: tuple[float, ...]


def alternate(
    remake: Callable[[Any], AbstractProblem],
    start: Any,
    solver: LevenbergMarquardt,
    *,
    rounds: int,
    steps: int = 1,
    enough: float = 0.0,
    uphill: int = 0,
) -> Alternation:
    """Make a problem, take steps on it, and again, each round from where the last one ended.

    **Arguments:** `remake(y)` makes the problem at `y`, always of the same shapes; `rounds` of `steps` each. A new problem may be worth more
    than the last one where that had come: after `uphill` rounds in a row that do not better the best one by a share `enough` the rounds end. The best is kept.
    """
    y, best, worse, history, lowered = start, None, 0, [], math.inf
    damping = jnp.asarray(solver.damping, float)
    for number in range(rounds + 1):
        problem = remake(y)
        value = float(_value(problem, y))
        history.append(value)
        if best is None or value < best.value:
            best = Alternation(y, problem, value, ())
        if value < lowered * (1 - enough) or not history[1:]:
            lowered, worse = value, 0
        else:
            worse += 1
        if number == rounds or worse > uphill or not math.isfinite(value):
            break
        found = _improve(problem, y, solver, steps, damping)
        y, damping = found.y, found.damping
    assert best is not None
    return best._replace(history=tuple(history))


class Renewal(NamedTuple):
    """Where rounds of renewed problems ended."""

    y: Any
    #: the last problem
    problem: Any
    #: `|r|^2` after every step; a rise marks a new problem
    history: tuple[float, ...]
    #: whether the last renewal hardly changed the problem, and the solver was able to step
    settled: bool


def renew(
    problem: AbstractProblem,
    start: Any,
    renewed: Callable[[int, Any, Any], tuple[Any, Any, bool]],
    tolerance: Callable[[int], float],
    solver: LevenbergMarquardt,
    *,
    rounds: int,
    steps: int,
    most: int,
) -> Renewal:
    """Minimise a problem, renew what its weights rest on, and again, until that hardly changes; energies of successive problems
    are not comparable, as in fits whose variances are found.

    **Arguments:** `renewed(number, problem, y)` makes of the round's minimum the next problem and start, and says whether these have settled;
    `tolerance(number)` is the share of the energy that a round's last step gains; `rounds` of `steps` at most, `most` steps in all.
    """
    y, history, settled = start, [], False
    for number in range(1, rounds + 1):
        this = eqx.tree_at(lambda s: s.rtol, solver, jnp.asarray(tolerance(number), float))
        found = _improve(problem, y, this, steps, jnp.asarray(solver.damping, float))
        if not history:
            history.append(float(2.0 * _value(problem, y)))
        passed = np.asarray(found.history)
        history.extend(float(value) for value in passed[np.isfinite(passed)])
        _LOG.info("fitting all frames together, round %d, %d of at most %d steps", number, len(history), most)
        if len(history) > most:
            return Renewal(found.y, problem, tuple(history), False)
        problem, y, settled = renewed(number, problem, found.y)
        if not (found.result == _DONE or found.result == _UNFINISHED):
            return Renewal(y, problem, tuple(history), False)
        if settled:
            break
    return Renewal(y, problem, tuple(history), settled)


def anneal(
    remake: Callable[[Any, Any], AbstractProblem],
    start: Any,
    solver: LevenbergMarquardt,
    stages: Iterable[Any],
    *,
    steps: int = 1,
) -> Any:
    """Make a problem `remake(y, stage)` for each stage, such as each of falling scales of robust weights, and take `steps` on it
    from where the last stage ended. What different problems are worth is not compared: the last place is the answer."""
    y, damping = start, jnp.asarray(solver.damping, float)
    for stage in stages:
        found = _improve(remake(y, stage), y, solver, steps, damping)
        y, damping = found.y, found.damping
    return y


def reweigh(
    remake: Callable[[Any], AbstractProblem],
    start: Any,
    solver: LevenbergMarquardt,
    *,
    rounds: int,
    steps: int,
    enough: float,
) -> tuple[Any, Int[Array, ""]]:
    """Make a problem `remake(y)`, take a few steps on it, and again, inside of `jit` and its kin: iteratively reweighted least squares
    for one small problem of many.

    Returns where that ended and how many steps it took: `rounds` of `steps` at most, fewer where no number of a step is above `enough`, or where
    steps are refused again and again, which is the end of what the precision shows.
    """

    def going_on(carry):
        _, damping, length, count = carry
        return (count < rounds * steps) & (length > enough) & (damping < STUCK)

    def improve(carry):
        y, damping, length, count = carry
        found = minimise(remake(y), y, solver, steps, damping)
        return (
            found.y,
            found.damping,
            jnp.where(jnp.isfinite(found.length), found.length, length),
            count + found.num_steps,
        )

    dtype = jnp.result_type(*(leaf for leaf in jax.tree.leaves(start) if eqx.is_inexact_array(leaf)))
    first = start, jnp.asarray(solver.damping, dtype), jnp.asarray(jnp.inf, dtype), jnp.array(0)
    y, _, _, count = jax.lax.while_loop(going_on, improve, first)
    return y, count


@eqx.filter_jit
def _value(problem: AbstractProblem, y: Any) -> Float[Array, ""]:
    return problem.value(y)


@eqx.filter_jit
def _improve(
    problem: AbstractProblem, y: Any, solver: LevenbergMarquardt, steps: int, damping: Float[Array, ""]
):
    return minimise(problem, y, solver, steps, damping)
