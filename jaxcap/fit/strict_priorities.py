"""Strict task priorities: a lower priority never disturbs a higher one.

Damped null-space projection (Baerlocher and Boulic 2004; joint-limits paper, section 5.2) over any number of
groups of energies. A step of a group lies in the null space of all groups above it.
"""

from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import optimistix as optx
from jaxtyping import Array, Float, Int
from threadpoolctl import threadpool_limits

from ..arguments import checked
from ..body.body import Body, pose_body
from ..body.pose import Pose
from ..body.retraction import project
from ..energy.check_energies import check_energy_arrays, explain_errors
from ..energy.energy import AbstractEnergy, Sum, energies, terms_of
from ..errors import InputError
from .pose_problem import PoseProblem
from .solvers.hierarchical_descent import AbstractHierarchicalProblem, hierarchical_move, minimise_hierarchy
from .solvers.hierarchical_least_squares import Damping, LinearSystem


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
    return hierarchical_move(_PriorityProblem(tuple(groups), body), pose, none).y


@eqx.filter_custom_jvp
def _minimise_in_order(groups, body, start, max_steps, damping, rtol, atol) -> OrderedSolution:
    problem = _PriorityProblem(groups, body)
    found = minimise_hierarchy(problem, project(body.skeleton, start), max_steps, damping, rtol, atol)
    values = energies(_concatenate_terms(groups), pose_body(body, found.y))
    return OrderedSolution(found.y, values, found.history, found.num_steps, found.result)


@_minimise_in_order.def_jvp
def _refuse_derivative(primals, tangents):
    raise InputError(
        "solve_in_order: strict priorities have no derivative where an inequality changes; differentiate `solve` with "
        "weights instead."
    )


_solve_in_order = eqx.filter_jit(_minimise_in_order)


class _PriorityProblem(AbstractHierarchicalProblem[Pose]):
    """Groups of energies on a body, with metres and radians in one measure."""

    groups: tuple[AbstractEnergy, ...]
    body: Body

    def upper(self):
        return _PriorityProblem(self.groups[:-1], self.body)

    def residuals(self, y: Pose):
        posed = pose_body(self.body, y)
        return [group.residual(posed) for group in self.groups]

    def linearise(self, y: Pose):
        problem = PoseProblem(_concatenate_terms(self.groups), self.body)
        residual, jacobian = problem.linearise(y)
        return LinearSystem(residual, jacobian * problem.scales())

    def retract(self, y: Pose, d: Float[Array, "D"]):
        problem = PoseProblem(_concatenate_terms(self.groups), self.body)
        return problem.retract(y, problem.scales() * d)


def _concatenate_terms(groups: tuple[AbstractEnergy, ...]) -> Sum:
    return Sum(tuple(term for group in groups for term in terms_of(group)))
