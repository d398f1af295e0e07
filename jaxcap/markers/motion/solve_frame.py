"""The pose of one frame by iteratively reweighted least squares with analytic derivatives."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from ...body.body import pose_body
from ...body.pose import Pose
from ...body.retraction import retract
from ...energy.energy import AbstractEnergy
from ...fit.alternate import reweighted_least_squares
from ...fit.frame_equations import frame_equations
from ...fit.linear_solvers.dense import DenseMatrix
from ...fit.solvers.descent import ConstrainedInfo
from ...fit.solvers.least_squares_problem import AbstractProblem
from ...fit.solvers.levenberg_marquardt import LevenbergMarquardt
from ..calibration.residuals import marker_residuals, residual_equations
from ..posture import posture_prior
from ..robust import robust_kernel, variance_ratio
from ..subject import Subject, marker_body

#: information below which a pose coordinate is undetermined: that of a marker with a deviation of a metre, a
#: metre from the joint
MIN_INFORMATION = 1.0


class SearchCriteria(eqx.Module):
    """Stopping criteria of the search for a pose."""

    max_iterations: int = eqx.field(static=True, default=12)
    #: squared length of the last step in standard deviations of the pose, those that the markers leave: its Newton decrement
    tolerance: float = eqx.field(static=True, default=0.01)
    #: least standard deviation of a marker in a first search, metres: from a distant start, markers of a limb that is not yet in
    #: place would otherwise be outliers, and remain so; zero for no such search
    least_deviation: float = eqx.field(static=True, default=0.0)


class SolvedFrame(NamedTuple):
    """The pose of one frame, and the residuals of its M markers."""

    pose: Pose
    #: metres; zero where not visible
    residuals: Float[Array, "M"]
    #: robust weights at the solution, 0 to 1; zero where not visible
    weights: Float[Array, "M"]
    #: median residual in standard deviations, at least one
    residual_scale: Float[Array, ""]
    iterations: Int[Array, ""]


class FrameProblem(AbstractProblem[Pose]):
    """Find the pose that minimises the robust squared marker residuals of a frame.

    The residuals are in standard deviations, scaled by their median.
    """

    subject: Subject
    positions: Float[Array, "M 3"]
    #: inverse variances, zero where not visible
    precision: Float[Array, "M"]
    #: energies of a user's own, which see the markers as vertices
    terms: AbstractEnergy | None = None

    def value(self, y):
        residual = marker_residuals(self.subject, y, self.positions)
        value = 0.5 * jnp.sum(robust_kernel(jnp.sum(residual**2, 1) * self.precision)[0])
        if self.terms is None:
            return value
        r = self.terms.residual(pose_body(marker_body(self.subject), y))
        return value + 0.5 * (r @ r)

    def information(self, y):
        def weigh(residual):
            return robust_kernel(jnp.sum(residual**2, 1) * self.precision)[1] * self.precision

        residual, side, matrix = residual_equations(self.subject, y, self.positions, weigh)
        value = 0.5 * jnp.sum(robust_kernel(jnp.sum(residual**2, 1) * self.precision)[0])
        if self.terms is not None:
            extra = frame_equations(self.terms, marker_body(self.subject), y)
            value, side, matrix = value + extra[0], side + extra[1], matrix + extra[2]
        # undetermined coordinates stay
        known = jnp.diagonal(matrix) > MIN_INFORMATION
        return ConstrainedInfo(value, jnp.where(known, side, 0.0), DenseMatrix(matrix).restricted(known))  # pyright: ignore[reportCallIssue]

    def retract(self, y, d):
        return retract(self.subject.skeleton, y, d)

    def scales(self):
        return jnp.ones(self.subject.skeleton.num_dofs, self.positions.dtype)


def solve_frame(
    subject: Subject,
    start: Pose,
    positions: Float[Array, "M 3"],
    seen: Bool[Array, "M"],
    search: SearchCriteria = SearchCriteria(),
    terms: AbstractEnergy | None = None,
) -> SolvedFrame:
    """Find the pose that minimises robust distances to the visible markers, in standard deviations.

    The deviations are scaled by the median residual before each step. So a distant start, or a subject that fits badly, does
    not make a marker look swapped. Pose coordinates that no visible marker determines keep their start
    values. Never fails: without visible markers the start is returned.
    """
    terms = posture_prior(subject, terms)
    precision = jnp.where(seen, subject.weights / subject.deviations**2, 0.0)
    counted = precision > 0

    def left(pose):
        squared = jnp.sum(marker_residuals(subject, pose, positions) ** 2, 1)
        return squared, variance_ratio(squared * precision, counted)

    solver = LevenbergMarquardt(0.0, 0.0, damping=1e-6, relative=True, energy_atol=search.tolerance)

    def find(start, least):
        def remake(pose):
            return FrameProblem(subject, positions, precision / (left(pose)[1] + least**2 * precision), terms)

        return reweighted_least_squares(remake, start, solver, max_steps=search.max_iterations)

    deviations = [search.least_deviation, 0.0] if search.least_deviation else [0.0]
    pose, counts = jax.lax.scan(find, start, jnp.array(deviations, precision.dtype))
    squared, wide = left(pose)
    return SolvedFrame(
        pose,
        jnp.where(seen, jnp.sqrt(squared), 0.0),
        jnp.where(counted, robust_kernel(squared * precision / wide)[1], 0.0),
        jnp.sqrt(wide),
        jnp.sum(counts),
    )
