"""Calibration in outer rounds of fits, with updates of variances and models between them.

The markers' variances, the axes without noticeable joint rotation, and the skin sliding are estimated from
the data. They are updated whenever the current fit has nearly converged.
"""

import logging
from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ...body.pose import Pose, retract
from ...fit.alternate import renew
from ...fit.linear.block_banded import BlockBanded
from ...fit.linear.precision import in_double
from ...fit.solvers.levenberg_marquardt import LevenbergMarquardt
from ..subject import Subject
from .calibration_parameters import shared_between
from .problem import CalibrationEstimate, CalibrationProblem, slid
from .residuals import marker_residuals
from .robust import MEDIAN, UNBOUNDED
from .rotation_prior import free_turning, turning_of
from .soft_tissue import find_skin, slide_deviation, sliding
from .variances import EXACT, marker_deviations

_LOG = logging.getLogger(__name__)

#: Marquardt's damping of the first step
FIRST_DAMPING = 1e-6
#: relative decrease of the cost in the last step of a fit, before and after the first updates
ROUGH, TOLERANCE = 1.5e-2, 5e-4
#: maximal number of steps of one fit
STEPS = 40
#: number of updates after rough fits
ROUGHLY = 2
#: number of the update from which the variances are those of the noise, and no longer of the template
FIRM = 4
#: and after which the rounds may end
SETTLED = 5

_SOLVER = LevenbergMarquardt(atol=1e-9, damping=FIRST_DAMPING, relative=True)


class Fit(NamedTuple):
    """The result of the outer rounds."""

    problem: CalibrationProblem
    estimate: CalibrationEstimate
    history: tuple[float, ...]
    converged: bool


def adjust(
    problem: CalibrationProblem, subject: Subject, poses: Pose, *, skin: bool, steps: int, rough: bool
) -> Fit:
    """Iterate fits at fixed variances and updates of the variances until both converge.

    All is in double precision, as the information of frames about a subject is a difference of large
    numbers.

    **Arguments:** `problem`, with initial deviations and turning; `skin`: if it may slide; `steps` at most;
    `rough` ends after the first updates.
    """
    return in_double(
        partial(_adjust, skin=skin and not rough, steps=steps, rough=rough), problem, subject, poses
    )


def _adjust(
    problem: CalibrationProblem, subject: Subject, poses: Pose, skin: bool, steps: int, rough: bool
) -> Fit:
    shared = shared_between(problem.template, subject, problem.joints)
    start = CalibrationEstimate(poses, shared, jnp.zeros((0, subject.num_markers, 3)))
    problem = _first_deviations(problem, start)

    def tolerance(number: int) -> float:
        # the first variances are those of the template's errors and only lead to better ones
        return ROUGH if rough or number <= ROUGHLY else TOLERANCE

    rounds, renewed = ROUGHLY + 1 if rough else steps, partial(_renewed, skin=skin)
    found = renew(problem, start, renewed, tolerance, _SOLVER, rounds=rounds, steps=STEPS, most=steps)
    return Fit(found.problem, found.y, found.history, found.settled)


def _renewed(
    number: int, problem: CalibrationProblem, y: CalibrationEstimate, skin: bool
) -> tuple[CalibrationProblem, CalibrationEstimate, bool]:
    """Update variances, stiff axes and skin from an estimate, and test if these have converged."""
    deviations = marker_deviations(problem, y)
    if number < 3:
        # one for all, so that no marker loses its weight to an error of its bone's length
        deviations = jnp.full_like(deviations, jnp.median(deviations))
    change = float(jnp.max(jnp.abs(deviations / problem.deviations - 1.0)))
    settled = change < 0.05 and number > SETTLED
    problem = eqx.tree_at(lambda p: p.deviations, problem, deviations)
    if y.slides.size:
        after = slide_deviation(problem.subject(y), np.asarray(problem.features), np.asarray(y.slides))
        settled = settled and abs(after / float(problem.slide_deviation) - 1.0) <= 0.1
        return eqx.tree_at(lambda p: p.slide_deviation, problem, jnp.asarray(after)), y, settled
    if skin and number == FIRM:
        features = sliding(problem.template, y.poses)
        found = find_skin(features, np.asarray(_residuals(problem, y)), np.asarray(problem.seen))
        if found is not None:
            _LOG.info("skin slides on its bones by %.1f mm per radian", 1000 * found)
            slides = jnp.zeros((features.shape[2], problem.template.num_markers, 3))
            replaced = jnp.asarray(features), jnp.asarray(found)
            problem = eqx.tree_at(lambda p: (p.features, p.slide_deviation), problem, replaced)
            return problem, CalibrationEstimate(y.poses, y.shared, slides), False
    poses, covariances = _free_poses(problem, y)
    turning = turning_of(problem.template.skeleton, poses, covariances)
    return eqx.tree_at(lambda p: p.turning, problem, turning), y, settled


@eqx.filter_jit
def _free_poses(problem: CalibrationProblem, y: CalibrationEstimate):
    """Compute poses without the rotation prior, and their covariances for given shared parameters."""
    free = eqx.tree_at(lambda p: p.turning, problem, free_turning(problem.template.skeleton))
    matrices, sides = free.pose_equations(y)
    factor = BlockBanded(matrices[:, None]).factorise()
    one = jnp.broadcast_to(jnp.eye(sides.shape[1], dtype=sides.dtype), matrices.shape)
    poses = jax.vmap(retract, (None, 0, 0))(problem.template.skeleton, y.poses, factor.solve(-sides))
    return poses, factor.backward(factor.forward(one))


@eqx.filter_jit
def _residuals(problem: CalibrationProblem, y: CalibrationEstimate):
    """Compute the robust residuals of all markers, metres; outliers are shrunk by their weights."""

    subject = problem.subject(y)

    def of_frame(frame):
        pose, place, there, phi = frame
        residual = marker_residuals(slid(subject, y.slides, phi), pose, place)
        root, _ = problem.weigh(residual, there)
        scale = problem.deviations / jnp.sqrt(jnp.maximum(subject.weights, 1e-9))
        return residual * (root * scale)[:, None]

    return jax.lax.map(of_frame, (y.poses, problem.places, problem.seen, problem.features))


def _first_deviations(problem: CalibrationProblem, y: CalibrationEstimate) -> CalibrationProblem:
    """Initialise all deviations by the median residual of the template."""
    whole = eqx.tree_at(lambda p: p.bound, problem, jnp.asarray(UNBOUNDED))
    left = np.sum(np.asarray(_residuals(whole, y)) ** 2, 2)[np.asarray(problem.seen)]
    first = max(float(np.sqrt(np.median(left) / MEDIAN)), EXACT)
    return eqx.tree_at(lambda p: p.deviations, problem, jnp.full_like(problem.deviations, first))
