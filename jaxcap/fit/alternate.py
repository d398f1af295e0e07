"""Outer rounds: a problem that is made anew where the last one led, such as with new pairs or weights."""

import math
from collections.abc import Callable, Iterable
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from .solvers.levenberg_marquardt import LevenbergMarquardt
from .solvers.minimise import minimise
from .solvers.problem import AbstractProblem


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
    y, best, worse, history = start, None, 0, []
    damping = jnp.asarray(solver.damping, float)
    for number in range(rounds + 1):
        problem = remake(y)
        value = float(_value(problem, y))
        history.append(value)
        if best is None or value < best.value * (1 - enough):
            best, worse = Alternation(y, problem, value, ()), 0
        else:
            worse += 1
        if number == rounds or worse > uphill or not math.isfinite(value):
            break
        y, damping = _improve(problem, y, solver, steps, damping)
    assert best is not None
    return best._replace(history=tuple(history))


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
        y, damping = _improve(remake(y, stage), y, solver, steps, damping)
    return y


@eqx.filter_jit
def _value(problem: AbstractProblem, y: Any) -> Float[Array, ""]:
    return problem.value(y)


@eqx.filter_jit
def _improve(
    problem: AbstractProblem, y: Any, solver: LevenbergMarquardt, steps: int, damping: Float[Array, ""]
):
    found = minimise(problem, y, solver, steps, damping)
    return found.y, found.damping
