"""The pose that minimises an energy, with derivatives of the solution."""

import equinox as eqx
import optimistix as optx
from jaxtyping import Array, Bool, Float, Int

from ..arguments import checked
from ..body.body import Body, pose_body
from ..body.pose import Pose
from ..body.retraction import project
from ..energy.check_energies import check_energy_arrays, explain_errors
from ..energy.energy import AbstractEnergy, energies
from ..errors import InputError
from ..value_checks import check_at_least
from .pose_problem import PoseProblem
from .precision import with_precision
from .solvers.implicit import implicit_minimum, is_trustworthy
from .solvers.levenberg_marquardt import LevenbergMarquardt
from .solvers.minimise import AnySolver


class Solution(eqx.Module):
    """The result of `solve`."""

    pose: Pose
    #: `|r|^2` of every term at the solution, by the term's name
    energies: dict[str, Float[Array, ""]]
    #: `|r|^2` after each step, NaN beyond the last
    history: Float[Array, "H"]
    num_steps: Int[Array, ""]
    #: `RESULTS.successful`, or the reason for stopping before convergence
    result: optx.RESULTS
    #: true if the solver converged and almost nothing is left to gain, so that derivatives by the implicit
    #: function theorem hold
    trustworthy: Bool[Array, ""]


@checked
def solve(
    energy: AbstractEnergy,
    body: Body,
    start: Pose,
    solver: AnySolver | None = None,
    max_steps: int = 64,
) -> Solution:
    """Find the pose of a body that minimises an energy, from a start near it.

    **Arguments:** `solver` is `LevenbergMarquardt()` where not given, or `GaussNewton()`, or any
    least-squares solver or minimiser of optimistix; `max_steps` bounds its steps. A start that the joints'
    types do not allow is projected.

    `jax.grad` and `jax.jvp` differentiate the solution by the implicit function theorem, by every array of
    the energy and of the body; not by the start, on which a minimum does not depend. Coordinates that no term
    determines stay at their start, in the derivative too. A failing solver raises nothing: see
    `Solution.result`, and `trustworthy` before a derivative is used.

    **Raises:** `InputError` for an object that is not a solver, and for an energy with inconsistent arrays or
    with indices of vertices or joints that the body does not have.
    """
    check_at_least("solve", 1, max_steps=max_steps)
    if start.scale.ndim:
        raise InputError(
            f"solve: `start` has {start.scale.shape[0]} frames; expected the pose of one frame. Many frames are solved by "
            "jax.lax.map, or by solve_sequence."
        )
    check_energy_arrays(energy, body)
    # data may have another precision than the body
    energy, start = with_precision((energy, start), body.vertices.dtype)
    problem = PoseProblem(energy, body)
    solver = LevenbergMarquardt() if solver is None else solver
    with explain_errors(energy, body, start):
        found = implicit_minimum(problem, project(body.skeleton, start), solver, max_steps, _project_pose)
        trustworthy = is_trustworthy(problem, found)
    terms = energies(energy, pose_body(body, found.y))
    return Solution(found.y, terms, found.history, found.num_steps, found.result, trustworthy)


def _project_pose(problem: PoseProblem, pose: Pose) -> Pose:
    """Project onto the manifold of the joints' own axes, which may be parameters."""
    return project(problem.body.skeleton, pose)
