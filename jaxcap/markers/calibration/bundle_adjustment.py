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

from ...body.pose import Pose
from ...body.retraction import retract
from ...fit.alternate import minimise_reweighted
from ...fit.linear_solvers.block_banded import BlockBanded
from ...fit.linear_solvers.float64 import in_float64
from ...fit.solvers.levenberg_marquardt import LevenbergMarquardt
from ..robust import MEDIAN_SQUARED_LENGTH, UNBOUNDED
from ..subject import Subject
from .calibration_parameters import shared_parameters
from .calibration_problem import CalibrationEstimate, CalibrationProblem, apply_sliding
from .prior_scales import slide_variances, update_scales
from .residuals import marker_residuals
from .rotation_prior import estimate_rotation_prior, free_deviation, wide_rotation_prior
from .soft_tissue import (
    MAX_SLIDING,
    MIN_SLIDING,
    RelativeModes,
    align_features,
    initial_slide_deviation,
    refit_slides,
    relative_modes,
    skin_features,
)
from .variances import MIN_DEVIATION, marker_deviations

_LOG = logging.getLogger(__name__)

#: Marquardt's damping of the first step
FIRST_DAMPING = 1e-6
#: relative decrease of the cost in the last step of a fit, before and after the first updates
ROUGH_TOLERANCE, TOLERANCE = 1.5e-2, 5e-4
#: maximal number of steps of one fit
MAX_FIT_STEPS = 40
#: number of updates after rough fits
NUM_ROUGH_UPDATES = 2
#: number of the update from which the variances are those of the noise, and no longer of the template
FIRST_NOISE_UPDATE = 4
#: and after which the rounds may end
MIN_UPDATES = 5
#: number of the last update that recomputes the features of the skin, so that the rounds converge
LAST_RENEWAL = 8
#: largest change of the logarithm of a prior's deviation in the last update
MAX_SCALE_CHANGE = 0.2

_SOLVER = LevenbergMarquardt(atol=1e-9, damping=FIRST_DAMPING, relative=True)


class AdjustmentResult(NamedTuple):
    """The result of the outer rounds."""

    problem: CalibrationProblem
    estimate: CalibrationEstimate
    history: tuple[float, ...]
    converged: bool


def bundle_adjust(
    problem: CalibrationProblem,
    subject: Subject,
    poses: Pose,
    *,
    allow_sliding: bool,
    max_steps: int,
    rough: bool,
) -> AdjustmentResult:
    """Iterate fits at fixed variances and updates of the variances until both converge.

    All is in double precision, as the information of frames about a subject is a difference of large
    numbers.

    **Arguments:** `problem`, with initial deviations and turning; `allow_sliding`: if it may slide; `max_steps` at most;
    `rough` ends after the first updates.
    """
    return in_float64(
        partial(_bundle_adjust, allow_sliding=allow_sliding and not rough, max_steps=max_steps, rough=rough),
        problem,
        subject,
        poses,
    )


def _bundle_adjust(
    problem: CalibrationProblem,
    subject: Subject,
    poses: Pose,
    allow_sliding: bool,
    max_steps: int,
    rough: bool,
) -> AdjustmentResult:
    shared = shared_parameters(problem.template, subject, problem.joints)
    start = CalibrationEstimate(poses, shared, jnp.zeros((0, subject.num_markers, 3)))
    wide = wide_rotation_prior(problem.template.skeleton, poses, free_deviation(problem.template))
    problem = _initial_deviations(eqx.tree_at(lambda p: p.rotation_prior, problem, wide), start)

    def tolerance(number: int) -> float:
        # the first variances are those of the template's errors and only lead to better ones
        return ROUGH_TOLERANCE if rough or number <= NUM_ROUGH_UPDATES else TOLERANCE

    rounds, renewed = (
        NUM_ROUGH_UPDATES + 1 if rough else max_steps,
        partial(_update_problem, allow_sliding=allow_sliding),
    )
    found = minimise_reweighted(
        problem, start, renewed, tolerance, _SOLVER, rounds=rounds, steps=MAX_FIT_STEPS, max_steps=max_steps
    )
    return AdjustmentResult(found.problem, found.y, found.history, found.converged)


def _update_problem(
    number: int, problem: CalibrationProblem, y: CalibrationEstimate, allow_sliding: bool
) -> tuple[CalibrationProblem, CalibrationEstimate, bool]:
    """Update variances, stiff axes and skin from an estimate, and test if these have converged."""
    deviations = marker_deviations(problem, y)
    if number < 3:
        # one for all, so that no marker loses its weight to an error of its bone's length
        deviations = jnp.full_like(deviations, jnp.median(deviations))
    change = float(jnp.max(jnp.abs(deviations / problem.deviations - 1.0)))
    settled = change < 0.05 and number > MIN_UPDATES
    problem = eqx.tree_at(lambda p: p.deviations, problem, deviations)
    if number >= FIRST_NOISE_UPDATE:
        problem, steady = _update_priors(problem, y)
        settled = settled and steady
    if y.slides.size:
        if number <= LAST_RENEWAL:
            problem, y = _renew_features(problem, y)
        return problem, y, settled
    if allow_sliding and number == FIRST_NOISE_UPDATE:
        features = skin_features(problem.template, y.poses)
        found = initial_slide_deviation(
            features, np.asarray(_robust_residuals(problem, y)), np.asarray(problem.seen)
        )
        if found is not None:
            _LOG.info("skin slides on its bones by %.1f mm per radian", 1000 * found)
            slides = jnp.zeros((features.shape[2], problem.template.num_markers, 3))
            replaced = jnp.asarray(features), jnp.full(slides.shape[:2], found)
            problem = eqx.tree_at(lambda p: (p.skin_features, p.slide_deviations), problem, replaced)
            return problem, CalibrationEstimate(y.poses, y.shared, slides), False
    deviation = free_deviation(problem.template)
    wide = wide_rotation_prior(problem.template.skeleton, y.poses, deviation)
    wide_problem = eqx.tree_at(lambda p: p.rotation_prior, problem, wide)
    poses, covariances = _poses_at_fixed_subject(wide_problem, y)
    turning = estimate_rotation_prior(problem.template.skeleton, poses, covariances, deviation)
    return eqx.tree_at(lambda p: p.rotation_prior, problem, turning), y, settled


def _update_priors(problem: CalibrationProblem, y: CalibrationEstimate) -> tuple[CalibrationProblem, bool]:
    """Update the deviations of the template and of the slides, and test if they hardly change."""
    groups, deviations = _next_priors(problem, y, relative_modes(problem.template))
    change = [jnp.zeros(1), jnp.log(deviations / problem.slide_deviations).ravel()]
    problem = eqx.tree_at(lambda p: p.slide_deviations, problem, deviations)
    if groups is not None and problem.prior_groups is not None:
        change.append(jnp.log(groups.scales / problem.prior_groups.scales))
        replaced = groups, groups.precision()
        problem = eqx.tree_at(lambda p: (p.prior_groups, p.prior), problem, replaced)
    return problem, bool(jnp.max(jnp.abs(jnp.concatenate(change))) <= MAX_SCALE_CHANGE)


@eqx.filter_jit
def _next_priors(problem: CalibrationProblem, y: CalibrationEstimate, modes: RelativeModes):
    size, template = len(problem.prior), problem.template
    covariance = problem.shared_covariance(y)
    groups = problem.prior_groups
    if groups is not None:
        groups = update_scales(groups, y.shared, covariance[:size, :size])
    deviations = problem.slide_deviations
    if y.slides.size:
        kinds, count = len(y.slides), y.slides[0].size
        blocks = covariance[size:, size:].reshape(kinds, count, kinds, count)
        own = blocks[jnp.arange(kinds), :, jnp.arange(kinds)]
        old = deviations[:, modes.markers] ** 2
        variances = slide_variances(y.slides, own, modes.rows, modes.bones, old, template.skeleton.num_joints)
        deviations = jnp.clip(jnp.sqrt(variances), MIN_SLIDING, MAX_SLIDING)[:, template.bones]
    return groups, deviations


def _renew_features(
    problem: CalibrationProblem, y: CalibrationEstimate
) -> tuple[CalibrationProblem, CalibrationEstimate]:
    """Compute the features anew from the poses, and the slides that shift the markers as before."""
    before = np.asarray(problem.skin_features)
    features = align_features(before, skin_features(problem.template, y.poses))
    slides = refit_slides(before, np.asarray(y.slides), features)
    problem = eqx.tree_at(lambda p: p.skin_features, problem, jnp.asarray(features))
    return problem, CalibrationEstimate(y.poses, y.shared, jnp.asarray(slides))


@eqx.filter_jit
def _poses_at_fixed_subject(problem: CalibrationProblem, y: CalibrationEstimate):
    """Compute poses by one step, and their covariances, for given shared parameters."""
    matrices, sides = problem.pose_equations(y)
    factor = BlockBanded(matrices[:, None]).factorise()
    one = jnp.broadcast_to(jnp.eye(sides.shape[1], dtype=sides.dtype), matrices.shape)
    poses = jax.vmap(retract, (None, 0, 0))(problem.template.skeleton, y.poses, factor.solve(-sides))
    return poses, factor.backward(factor.forward(one))


@eqx.filter_jit
def _robust_residuals(problem: CalibrationProblem, y: CalibrationEstimate):
    """Compute the robust residuals of all markers, metres; outliers are shrunk by their weights."""

    subject = problem.subject(y)

    def of_frame(frame):
        pose, place, visible, phi = frame
        residual = marker_residuals(apply_sliding(subject, y.slides, phi), pose, place)
        root, _ = problem.root_weights_and_cost(residual, visible)
        scale = problem.deviations / jnp.sqrt(jnp.maximum(subject.weights, 1e-9))
        return residual * (root * scale)[:, None]

    return jax.lax.map(of_frame, (y.poses, problem.positions, problem.seen, problem.skin_features))


def _initial_deviations(problem: CalibrationProblem, y: CalibrationEstimate) -> CalibrationProblem:
    """Initialise all deviations by the median residual of the template."""
    bound = jnp.full_like(problem.outlier_bound, UNBOUNDED)
    whole = eqx.tree_at(lambda p: p.outlier_bound, problem, bound)
    left = np.sum(np.asarray(_robust_residuals(whole, y)) ** 2, 2)[np.asarray(problem.seen)]
    first = max(float(np.sqrt(np.median(left) / MEDIAN_SQUARED_LENGTH)), MIN_DEVIATION)
    return eqx.tree_at(lambda p: p.deviations, problem, jnp.full_like(problem.deviations, first))
