"""Problems in one chart, for the solvers of other packages."""

from typing import Any

from ..arguments import checked
from ..body.pose import Motion
from .sequences.check_sequence import check_sequence
from .sequences.sequence_problem import SequenceEstimate, SequenceProblem
from .solvers.least_squares_problem import AbstractProblem
from .solvers.single_chart import FlatProblem


@checked
def flat_problem(problem: AbstractProblem, start: Any) -> FlatProblem:
    """Make a problem flat about a start, for solvers such as those of jaxopt and optax.

    They minimise `flat.value` from `flat.start`, and `flat.to_manifold` maps their result to poses, where
    `flat` is the returned `FlatProblem`.

    **Arguments:** `start` is a pose for a `PoseProblem`. For a `SequenceProblem` it is an estimate, or poses stacked
    over frames, with shared unknowns starting at the unchanged body, as in `solve_sequence`.

    **Raises:** `InputError` for a sequence with inconsistent frames.
    """
    if isinstance(problem, SequenceProblem) and not isinstance(start, SequenceEstimate):
        poses = start.poses if isinstance(start, Motion) else start
        check_sequence(problem, poses)
        start = problem.start(poses)
    return FlatProblem(problem, start)
