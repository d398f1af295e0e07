"""Calibration at fixed variances, with derivatives: one minimum of the problem that `calibrate` updates."""

import equinox as eqx
import optimistix as optx
from jaxtyping import Array, Bool, Float, Int

from ...arguments import checked
from ...body.pose import Pose
from ...fit.solvers.implicit import energy_at, implicit_minimum, is_trustworthy
from ...fit.solvers.levenberg_marquardt import LevenbergMarquardt
from ...fit.solvers.minimise import AnySolver
from ...value_checks import check_at_least
from ..subject import Subject
from .calibration_problem import CalibrationEstimate, CalibrationProblem


class CalibrationSolution(eqx.Module):
    """The result of `solve_calibration`."""

    subject: Subject
    poses: Pose
    estimate: CalibrationEstimate
    #: `|r|^2` at the solution
    energy: Float[Array, ""]
    #: `|r|^2` after each step, NaN beyond the last
    history: Float[Array, "H"]
    num_steps: Int[Array, ""]
    #: `RESULTS.successful`, or why the solver stopped before it converged
    result: optx.RESULTS
    #: true if the solver converged and hardly anything is left to gain, so that derivatives are valid
    trustworthy: Bool[Array, ""]


def _check_start(problem: CalibrationProblem, start: CalibrationEstimate) -> None:
    kinds = problem.skin_features.shape[2]
    expected = {
        "poses": (start.poses.scale.shape, (len(problem.positions),)),
        "shared": (start.shared.shape, (len(problem.prior),)),
        "slides": (start.slides.shape, (kinds, problem.template.num_markers, 3)),
    }
    for name, (given, needed) in expected.items():
        if given != needed:
            raise ValueError(f"`start.{name}` has the shape {given}; expected {needed}, as the problem has.")


@checked
def solve_calibration(
    problem: CalibrationProblem,
    start: CalibrationEstimate,
    solver: AnySolver | None = None,
    max_steps: int = 100,
) -> CalibrationSolution:
    """Find the subject and the poses that minimise a calibration's energy.

    All that `calibrate` updates between fits is fixed. `jax.grad` and `jax.jvp` differentiate the solution
    by the implicit function theorem, with respect to every array of the problem: positions, deviations, the
    prior, the template. The information of frames about a subject is a difference of large numbers, so
    derivatives need float64: set `jax_enable_x64`, and give a problem and a start in it.

    **Raises:** `InputError` for a start of other frames or unknowns than those of the problem.
    """
    check_at_least("solve_calibration", 1, max_steps=max_steps)
    _check_start(problem, start)
    solver = LevenbergMarquardt(0.0, 1e-10, damping=1e-6, relative=True) if solver is None else solver
    found = implicit_minimum(problem, start, solver, max_steps)
    trustworthy = is_trustworthy(problem, found)
    return CalibrationSolution(
        problem.subject(found.y),
        found.y.poses,
        found.y,
        energy_at(problem, found.y),
        found.history,
        found.num_steps,
        found.result,
        trustworthy,
    )
