"""Minimisation of several sums of squares in strict order, on a manifold: a lower level never disturbs a higher one.

Damped null-space steps (Baerlocher and Boulic 2004), with a line search over all levels, and with corrections where the
curvature of the upper levels leads a step away from their minima.
"""

import abc
from typing import Any, Generic, NamedTuple, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array, Bool, Float, Int

from .hierarchical_least_squares import Damping, LinearSystem, constrained_step, hierarchical_step
from .levenberg_marquardt import tree_where

Unknown = TypeVar("Unknown")

#: largest number of halvings of a step
MAX_HALVINGS = 8
#: largest number of corrections that return a candidate to the levels above, which it left along their
#: curvature
MAX_CORRECTIONS = 6


class AbstractHierarchicalProblem(eqx.Module, Generic[Unknown]):
    """Sums of squares over a manifold in strict order, highest first."""

    @abc.abstractmethod
    def residuals(self, y: Unknown) -> list[Float[Array, "R"]]:
        """Compute the residual of every level."""

    @abc.abstractmethod
    def linearise(self, y: Unknown) -> LinearSystem:
        """Linearise all levels in one pass, concatenated, in scaled tangents."""

    @abc.abstractmethod
    def upper(self) -> "AbstractHierarchicalProblem[Unknown]":
        """Make the problem of all levels but the last."""

    @abc.abstractmethod
    def retract(self, y: Unknown, d: Float[Array, "D"]) -> Unknown:
        """Move from `y` along a scaled tangent."""

    def values(self, y: Unknown) -> Float[Array, "G"]:
        """Compute `|r|^2` of every level."""
        return jnp.stack([r @ r for r in self.residuals(y)])

    def linearise_levels(self, y: Unknown) -> list[LinearSystem]:
        """Linearise every level."""
        edges = np.cumsum([len(r) for r in jax.eval_shape(self.residuals, y)])[:-1]
        parts = (jnp.split(array, edges) for array in self.linearise(y))
        return [LinearSystem(r, j) for r, j in zip(*parts, strict=True)]


class HierarchicalMinimum(eqx.Module):
    """The result of `minimise_hierarchy`."""

    y: Any
    #: `|r|^2` of every level after each step, highest first, NaN beyond the last
    history: Float[Array, "H G"]
    num_steps: Int[Array, ""]
    #: `RESULTS.successful`, or the reason for stopping before convergence
    result: optx.RESULTS


class HierarchicalStep(NamedTuple):
    """The result of a step on all levels."""

    y: Any
    #: `|r|^2` of every level
    values: Float[Array, "G"]
    #: changes of the values that count as nothing
    slack: Float[Array, "G"]
    #: largest component of the whole step
    length: Float[Array, ""]
    #: the share of the step that was taken, zero if none helps
    share: Float[Array, ""]


def minimise_hierarchy(
    problem: AbstractHierarchicalProblem, start: Any, max_steps: int, damping, rtol, atol
) -> HierarchicalMinimum:
    """Minimise the first level; among its minima, the second; and so on.

    **Arguments:** `damping`, the smallest constant on the diagonal of a level's normal equations. The steps end where no
    level changes by more than the share `rtol` of it, or no component of a step is longer than `atol`.
    """

    def going(carry):
        *_, steps, done = carry
        return ~done & (steps < max_steps)

    def step(carry):
        y, before, relative, history, steps, _ = carry
        found = hierarchical_move(problem, y, Damping(damping, relative))
        flat = (jnp.abs(found.values - before) <= rtol * before + found.slack).all()
        # if no part of a step helps, one nearer to the steepest descent may
        done = (found.length < atol) | (flat & ((found.share > 0) | (relative >= 1.0)))
        grown = jnp.where(found.share > 0, 10.0, 100.0) * jnp.maximum(relative, 1e-5)
        relative = jnp.where(found.share == 1.0, relative / 10, grown)
        history = history.at[steps].set(found.values, mode="drop")
        return found.y, found.values, relative, history, steps + 1, done

    first = problem.values(start)
    history = jnp.full((max_steps, len(first)), jnp.nan, first.dtype)
    carry = start, first, jnp.zeros_like(damping), history, jnp.array(0), jnp.array(False)
    y, last, _, history, steps, done = jax.lax.while_loop(going, step, carry)
    good, bad = optx.RESULTS.successful, optx.RESULTS.nonlinear_max_steps_reached
    result = optx.RESULTS.where(done, good, bad)
    result = optx.RESULTS.where(jnp.isfinite(last).all(), result, optx.RESULTS.nonfinite)
    return HierarchicalMinimum(y, history, steps, result)


def hierarchical_move(problem: AbstractHierarchicalProblem, y: Any, damping: Damping) -> HierarchicalStep:
    """Take one step on all levels; `y` is kept where no part of the step helps."""
    levels = problem.linearise_levels(y)
    before = jnp.stack([level.residual @ level.residual for level in levels])
    if len(levels) == 1:
        d, taken = hierarchical_step(levels, damping), levels
    else:
        upper = problem.upper()
        d, taken = constrained_step(levels, lambda d: upper.linearise(problem.retract(y, d)), damping)
    eps = jnp.finfo(d.dtype).eps
    # rounding, and the change by a move of the root of the precision in the stiffest direction
    stiffest = jnp.stack([jnp.linalg.norm(level.jacobian.T @ level.jacobian) for level in taken])
    rounding, smallest = 10 * eps * before, 0.01 * eps * jnp.maximum(stiffest, 1.0)
    slack = smallest + rounding

    def bounds(share):
        """Compute the allowed values: a lower level may rise as far as the linearised step predicts."""
        linear = [level.residual + share * level.jacobian @ d for level in levels]
        return jnp.maximum(before, jnp.stack([r @ r for r in linear])).at[0].set(before[0])

    def failed(carry):
        _, _, better, _, halvings = carry
        return ~better & (halvings <= MAX_HALVINGS)

    def halve(carry):
        _, _, _, share, halvings = carry
        most = bounds(share)
        moved = problem.retract(y, share * d)
        candidate, there = _correct(problem, moved, before, most, 1e-4 * smallest + rounding, damping)
        better = _compare_values(there, before, most, slack)[0]
        return candidate, there, better, share / 2, halvings + 1

    start = y, before, jnp.array(False), jnp.ones((), d.dtype), jnp.array(0)
    candidate, there, better, share, _ = jax.lax.while_loop(failed, halve, start)
    y, after = tree_where(better, candidate, y), jnp.where(better, there, before)
    length = jnp.max(jnp.abs(d), initial=0.0)
    return HierarchicalStep(y, after, slack, length, jnp.where(better, 2 * share, 0.0))


def _compare_values(candidate, before, upper_bounds, slack) -> tuple[Bool[Array, ""], Bool[Array, ""]]:
    """Test if a candidate is better, and if a level other than the last rejects it.

    It is better if a level has fallen and none above it has risen. It is also better if none has risen by
    more than the gains of the levels above it allow, when these gains are too small to show in their own
    values.
    """
    level, fallen, spoilt = jnp.array(True), jnp.array(False), jnp.array(False)
    for number in range(len(candidate)):
        fallen = fallen | (level & (candidate[number] < before[number] - slack[number]))
        level = level & (candidate[number] <= upper_bounds[number] + slack[number])
        spoilt = spoilt | (~fallen & ~level) if number < len(candidate) - 1 else spoilt
    paid = level & (upper_bounds > before + slack).any()
    return (fallen | paid) & jnp.isfinite(candidate).all(), spoilt


def _correct(problem: AbstractHierarchicalProblem, y: Any, before, upper_bounds, slack, damping: Damping):
    """Correct a candidate back to its values of the upper levels; also return all values."""
    if len(before) == 1:
        return y, problem.values(y)
    upper = problem.upper()

    def spoilt(carry):
        _, there, rounds = carry
        return _compare_values(there, before, upper_bounds, slack)[1] & (rounds < MAX_CORRECTIONS)

    def repair(carry):
        y, _, rounds = carry
        whole = damping._replace(relative=jnp.zeros_like(damping.relative))
        y = problem.retract(y, hierarchical_step(upper.linearise_levels(y), whole))
        return y, problem.values(y), rounds + 1

    y, there, _ = jax.lax.while_loop(spoilt, repair, (y, problem.values(y), jnp.array(0)))
    return y, there
