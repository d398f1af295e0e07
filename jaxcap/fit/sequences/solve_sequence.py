"""Joint solution of all frames of a sequence and their shared unknowns, with derivatives."""

from typing import Any

import equinox as eqx
import optimistix as optx
from jaxtyping import Array, Bool, Float, Int

from ...arguments import checked
from ...body.body import Body
from ...body.pose import Motion, Pose
from ...value_checks import check_at_least
from ..precision import with_precision
from ..solvers.implicit import energy_at, implicit_minimum, is_trustworthy
from ..solvers.levenberg_marquardt import LevenbergMarquardt
from ..solvers.minimise import AnySolver
from .check_sequence import checked_start
from .sequence_problem import SequenceEstimate, SequenceProblem


class SequenceSolution(eqx.Module):
    """The result of `solve_sequence`."""

    body: Body
    poses: Pose
    #: value of each shared unknown by its name
    values: dict[str, Any]
    #: `|r|^2` at the solution
    energy: Float[Array, ""]
    #: `|r|^2` after each step, NaN beyond the last
    history: Float[Array, "H"]
    num_steps: Int[Array, ""]
    #: `RESULTS.successful`, or the reason for stopping before convergence
    result: optx.RESULTS
    #: true if the solver converged and almost nothing is left to gain, so that derivatives by the implicit
    #: function theorem hold
    trustworthy: Bool[Array, ""]

    @property
    def estimate(self) -> SequenceEstimate:
        """The unknowns at the solution."""
        return SequenceEstimate(self.poses, self.values)


@checked
def solve_sequence(
    problem: SequenceProblem,
    start: Pose | Motion | SequenceEstimate,
    solver: AnySolver | None = None,
    max_steps: int = 64,
) -> SequenceSolution:
    """Find the poses of all frames, and the shared unknowns, that minimise the energies of a problem.

    **Arguments:** `start` poses stacked over frames, with shared unknowns starting at the unchanged body, or
    an estimate; `solver` is `LevenbergMarquardt()` where not given, or any of optimistix's; `max_steps`
    bounds its steps.

    `jax.grad` and `jax.jvp` differentiate the solution by the implicit function theorem, by every array of
    the problem: data, weights, priors and the body. A failing solver raises nothing: see
    `SequenceSolution.result`, and `trustworthy` before a derivative is used.

    **Raises:** `InputError` for inconsistent frames, and for energies with arrays that do not fit the body.
    """
    # data may have another precision than the body
    dtype = problem.body.vertices.dtype
    problem, start = with_precision((problem, start), dtype)
    start = checked_start(problem, start)
    check_at_least("solve_sequence", 1, max_steps=max_steps)
    solver = LevenbergMarquardt() if solver is None else solver
    found = implicit_minimum(problem, problem.project_feasible(start), solver, max_steps, _project_poses)
    trustworthy = is_trustworthy(problem, found)
    estimate, energy = found.y, energy_at(problem, found.y)
    return SequenceSolution(
        problem.body_at(estimate.values),
        estimate.poses,
        estimate.values,
        energy,
        found.history,
        found.num_steps,
        found.result,
        trustworthy,
    )


def _project_poses(problem: SequenceProblem, y: SequenceEstimate) -> SequenceEstimate:
    """Project onto the manifold of the joints' own axes, which may be parameters."""
    return SequenceEstimate(problem.start(y.poses).poses, y.values)
