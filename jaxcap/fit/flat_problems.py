"""Problems in one chart, for the solvers of other packages."""

from typing import Any

from ..arguments import checked
from ..body.pose import Pose
from ..energy.check_energies import check_energy_arrays
from ..errors import InputError
from .pose_problem import PoseProblem
from .sequences.check_sequence import checked_start
from .sequences.sequence_problem import SequenceProblem
from .solvers.least_squares_problem import AbstractProblem
from .solvers.single_chart import FlatProblem


@checked
def flat_problem(problem: AbstractProblem, start: Any) -> FlatProblem:
    """Make a problem flat about a start, for solvers such as those of jaxopt and optax.

    They minimise `flat.value` from `flat.start`, and `flat.to_manifold` maps their result to poses, where
    `flat` is the returned `FlatProblem`.

    **Arguments:** `start` is a pose for a `PoseProblem`. For a `SequenceProblem` it is an estimate, or poses stacked
    over frames, with shared unknowns starting at the unchanged body, as in `solve_sequence`.

    **Raises:** `InputError` for a sequence with inconsistent frames, for a problem with bounds or equal bone lengths, which
    a flat problem does not have, and for an energy with arrays that do not fit the body.
    """
    constraint = problem.describe_constraints()
    if constraint is not None:
        raise InputError(
            f"flat_problem: the problem has {constraint}, which a flat problem would ignore; use LevenbergMarquardt()."
        )
    if isinstance(problem, PoseProblem):
        if not isinstance(start, Pose) or start.scale.ndim:
            raise InputError("flat_problem: `start` is not the pose of one frame, as a PoseProblem needs.")
        check_energy_arrays(problem.energy, problem.body)
    if isinstance(problem, SequenceProblem):
        start = checked_start(problem, start)
    return FlatProblem(problem, start)
