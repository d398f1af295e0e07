"""Strict task priorities: a lower priority never disturbs a higher one.

Damped null-space projection (Baerlocher and Boulic 2004; joint-limits paper, section 5.2) over any number of
groups of energies. A step of a group lies in the null space of all groups above it.
"""

from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array, Bool, Float, Int
from threadpoolctl import threadpool_limits

from ..arguments import checked
from ..body.body import Body, pose_body
from ..body.pose import Pose
from ..body.retraction import project
from ..energy.check_energies import check_energy_arrays, explain_errors
from ..energy.energy import AbstractEnergy, Sum, energies, terms_of
from ..errors import InputError
from .pose_problem import PoseProblem
from .solvers.hierarchical_least_squares import Damping, LinearSystem, constrained_step, hierarchical_step
from .solvers.levenberg_marquardt import tree_where
from .solvers.minimise import HISTORY_LENGTH

#: largest number of halvings of a step
MAX_HALVINGS = 8
#: largest number of corrections that return a candidate to the groups above, which it left along their
#: curvature
MAX_CORRECTIONS = 6


class OrderedSolution(eqx.Module):
    """The result of `solve_in_order`: that of `solve`, with an energy for each of G groups."""

    pose: Pose
    #: `|r|^2` of every term at the solution, by the term's name
    energies: dict[str, Float[Array, ""]]
    #: `|r|^2` of every group after each step, highest first, NaN beyond the last
    history: Float[Array, "H G"]
    num_steps: Int[Array, ""]
    #: `RESULTS.successful`, or the reason for stopping before convergence
    result: optx.RESULTS


@checked
def solve_in_order(
    groups: Sequence[AbstractEnergy],
    body: Body,
    start: Pose,
    *,
    max_steps: int = 64,
    damping: float | Float[Array, ""] = 1e-6,
    rtol: float | Float[Array, ""] = 1e-5,
    atol: float | Float[Array, ""] = 1e-6,
) -> OrderedSolution:
    """Find the pose that minimises the first energy; among such poses, the second; and so on.

    **Arguments:** `groups` at least one energy, highest priority first; a sum is one group. Residuals that
    vanish in a valid region, as those of `JointLimits`, are inequalities: inside the region they leave the
    lower groups free, and no lower group leads out of it. `damping` is the smallest constant on the diagonal
    of a group's normal equations; `max_steps` bounds the steps; `rtol` and `atol` end them where no group's
    energy changes by more than that share of it, or no coordinate by more than that many radians. A start
    that the joints' types do not allow is projected.

    No step raises the energy of a group for the sake of a lower one, to machine precision. A failing solver
    raises nothing: see `OrderedSolution.result`. It cannot be differentiated: a lower group's minimum has no
    derivative where inequalities change.

    **Raises:** `ValueError` where there is no group, `InputError` where it is differentiated.
    """
    if not groups:
        raise ValueError("`groups` is empty; expected at least one energy, highest priority first.")
    for group in groups:
        check_energy_arrays(group, body)
    numbers = (jnp.asarray(number, body.vertices.dtype) for number in (damping, rtol, atol))
    # threads of BLAS and of XLA wait for each other, and the matrices of a pose are small
    with threadpool_limits(1, "blas"), explain_errors(Sum(tuple(groups)), body, start):
        return jax.block_until_ready(_solve_in_order(tuple(groups), body, start, max_steps, *numbers))


@checked
def priority_step(
    groups: Sequence[AbstractEnergy], body: Body, pose: Pose, damping: float | Float[Array, ""] = 1e-6
) -> Pose:
    """Take one step of `solve_in_order`, for use under `jit` in place of an unconstrained step; the same pose
    where no step helps.

    On a busy machine it is a hundred times faster with one thread for BLAS (`OPENBLAS_NUM_THREADS=1`), which
    `solve_in_order` sets itself.
    """
    dtype = body.vertices.dtype
    none = Damping(jnp.asarray(damping, dtype), jnp.zeros((), dtype))
    return _step(_PriorityProblem(tuple(groups), body), pose, none)[0]


@eqx.filter_custom_jvp
def _minimise_in_order(groups, body, start, max_steps, damping, rtol, atol) -> OrderedSolution:
    order = _PriorityProblem(groups, body)

    def going(carry):
        *_, steps, done = carry
        return ~done & (steps < max_steps)

    def step(carry):
        pose, before, share, history, steps, _ = carry
        pose, after, slack, length, taken = _step(order, pose, Damping(damping, share))
        flat = (jnp.abs(after - before) <= rtol * before + slack).all()
        # if no part of a step helps, one nearer to the steepest descent may
        done = (length < atol) | (flat & ((taken > 0) | (share >= 1.0)))
        grown = jnp.where(taken > 0, 10.0, 100.0) * jnp.maximum(share, 1e-5)
        share = jnp.where(taken == 1.0, share / 10, grown)
        return pose, after, share, history.at[steps].set(after, mode="drop"), steps + 1, done

    pose = project(body.skeleton, start)
    first = order.values(pose)
    history = jnp.full((HISTORY_LENGTH, len(groups)), jnp.nan, first.dtype)
    carry = pose, first, jnp.zeros_like(damping), history, jnp.array(0), jnp.array(False)
    pose, last, _, history, steps, done = jax.lax.while_loop(going, step, carry)
    good, bad = optx.RESULTS.successful, optx.RESULTS.nonlinear_max_steps_reached
    result = optx.RESULTS.where(done, good, bad)
    result = optx.RESULTS.where(jnp.isfinite(last).all(), result, optx.RESULTS.nonfinite)
    return OrderedSolution(
        pose, energies(_concatenate_terms(groups), pose_body(body, pose)), history, steps, result
    )


@_minimise_in_order.def_jvp
def _refuse_derivative(primals, tangents):
    raise InputError(
        "solve_in_order: strict priorities have no derivative where an inequality changes; differentiate `solve` with "
        "weights instead."
    )


_solve_in_order = eqx.filter_jit(_minimise_in_order)


class _PriorityProblem(eqx.Module):
    """Groups of energies on a body, with metres and radians in one measure."""

    groups: tuple[AbstractEnergy, ...]
    body: Body

    @property
    def upper(self) -> "_PriorityProblem":
        return _PriorityProblem(self.groups[:-1], self.body)

    def values(self, pose: Pose) -> Float[Array, "G"]:
        residuals = self.residuals(pose)
        return jnp.stack([r @ r for r in residuals])

    def residuals(self, pose: Pose) -> list[Float[Array, "R"]]:
        posed = pose_body(self.body, pose)
        return [group.residual(posed) for group in self.groups]

    def linearise(self, pose: Pose) -> LinearSystem:
        """Linearise all groups in one pass, concatenated."""
        problem = PoseProblem(_concatenate_terms(self.groups), self.body)
        residual, jacobian = problem.linearise(pose)
        return LinearSystem(residual, jacobian * problem.scales())

    def linearise_levels(self, pose: Pose) -> list[LinearSystem]:
        edges = np.cumsum([len(r) for r in jax.eval_shape(self.residuals, pose)])[:-1]
        parts = (jnp.split(array, edges) for array in self.linearise(pose))
        return [LinearSystem(r, j) for r, j in zip(*parts, strict=True)]

    def retract(self, pose: Pose, d: Float[Array, "D"]) -> Pose:
        problem = PoseProblem(_concatenate_terms(self.groups), self.body)
        return problem.retract(pose, problem.scales() * d)


def _concatenate_terms(groups: tuple[AbstractEnergy, ...]) -> Sum:
    return Sum(tuple(term for group in groups for term in terms_of(group)))


def _step(order: _PriorityProblem, pose: Pose, damping):
    """Take one step: `(pose, energies of the groups, their negligible changes, length of the step, share of
    it taken)`.
    """
    levels = order.linearise_levels(pose)
    before = jnp.stack([level.residual @ level.residual for level in levels])
    if len(levels) == 1:
        d, taken = hierarchical_step(levels, damping), levels
    else:
        d, taken = constrained_step(levels, lambda d: order.upper.linearise(order.retract(pose, d)), damping)
    eps = jnp.finfo(d.dtype).eps
    # rounding, and the change by a move of the root of the precision in the stiffest direction
    stiffest = jnp.stack([jnp.linalg.norm(level.jacobian.T @ level.jacobian) for level in taken])
    rounding, smallest = 10 * eps * before, 0.01 * eps * jnp.maximum(stiffest, 1.0)
    slack = smallest + rounding

    def bounds(share):
        """Compute the allowed energies: a lower group may rise as far as the linearised step predicts."""
        linear = [level.residual + share * level.jacobian @ d for level in levels]
        return jnp.maximum(before, jnp.stack([r @ r for r in linear])).at[0].set(before[0])

    def failed(carry):
        _, _, better, _, halvings = carry
        return ~better & (halvings <= MAX_HALVINGS)

    def halve(carry):
        _, _, _, share, halvings = carry
        most = bounds(share)
        moved = order.retract(pose, share * d)
        candidate, there = _correct(order, moved, before, most, 1e-4 * smallest + rounding, damping)
        better = _compare_energies(there, before, most, slack)[0]
        return candidate, there, better, share / 2, halvings + 1

    start = pose, before, jnp.array(False), jnp.ones((), d.dtype), jnp.array(0)
    candidate, there, better, share, _ = jax.lax.while_loop(failed, halve, start)
    pose, after = tree_where(better, candidate, pose), jnp.where(better, there, before)
    return pose, after, slack, jnp.max(jnp.abs(d), initial=0.0), jnp.where(better, 2 * share, 0.0)


def _compare_energies(candidate, before, upper_bounds, slack) -> tuple[Bool[Array, ""], Bool[Array, ""]]:
    """Test if a candidate is better, and if a group other than the last rejects it.

    It is better if a group has fallen and none above it has risen. It is also better if none has risen by
    more than the gains of the groups above it allow, when these gains are too small to show in their own
    energies.
    """
    level, fallen, spoilt = jnp.array(True), jnp.array(False), jnp.array(False)
    for number in range(len(candidate)):
        fallen = fallen | (level & (candidate[number] < before[number] - slack[number]))
        level = level & (candidate[number] <= upper_bounds[number] + slack[number])
        spoilt = spoilt | (~fallen & ~level) if number < len(candidate) - 1 else spoilt
    paid = level & (upper_bounds > before + slack).any()
    return (fallen | paid) & jnp.isfinite(candidate).all(), spoilt


def _correct(order: _PriorityProblem, pose: Pose, before, upper_bounds, slack, damping):
    """Correct a candidate back to its values of the upper groups; also return its energies."""
    if len(order.groups) == 1:
        return pose, order.values(pose)

    def spoilt(carry):
        _, there, rounds = carry
        return _compare_energies(there, before, upper_bounds, slack)[1] & (rounds < MAX_CORRECTIONS)

    def repair(carry):
        pose, _, rounds = carry
        whole = damping._replace(relative=jnp.zeros_like(damping.relative))
        pose = order.retract(pose, hierarchical_step(order.upper.linearise_levels(pose), whole))
        return pose, order.values(pose), rounds + 1

    pose, there, _ = jax.lax.while_loop(spoilt, repair, (pose, order.values(pose), jnp.array(0)))
    return pose, there
