"""The markers' standard deviations from the residuals of a fit."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from ...batched_map import map_batches
from ...fit.linear_solvers.cholesky import factorise
from ..robust import robust_kernel
from .calibration_problem import BATCH_SIZE, RIDGE, CalibrationEstimate, CalibrationProblem, apply_sliding
from .residuals import linearise_residuals
from .rotation_prior import rotation_prior_equations

#: lower limit of deviations, metres
MIN_DEVIATION = 2e-5
#: weight of the variance of all markers in that of one, as a number of observed coordinates
SHRINKAGE_WEIGHT = 10.0


@eqx.filter_jit
def marker_deviations(problem: CalibrationProblem, y: CalibrationEstimate) -> Float[Array, "M"]:
    """Estimate the standard deviation of every marker from its own residuals, metres, not below `MIN_DEVIATION`.

    Residuals are smaller than the noise, as poses adapt to it. So the degrees of freedom of a marker, three
    a frame, are reduced by its leverage on the frame's pose, and by three for its own position. With few
    observations the estimate is close to that of all markers. A frame counts as often as its weight says. The estimate is limited to between a third and
    `max_deviation_ratio` times that, so that no bone depends on one marker alone.
    """
    subject, dofs = problem.subject(y), problem.template.skeleton.num_dofs
    information = subject.weights / problem.deviations**2
    used = problem.seen & (subject.weights > 0)

    def of_frame(frame):
        pose, place, visible, phi, weight = frame
        rows = linearise_residuals(apply_sliding(subject, y.slides, phi), pose, place)
        squared = jnp.sum(rows.residual**2, 1)
        slopes = jnp.where(visible, robust_kernel(squared * information, problem.outlier_bound)[1], 0.0)
        flat = (rows.by_pose * jnp.sqrt(weight * slopes * information)[:, None, None]).reshape(-1, dofs)
        gram = flat.T @ flat + rotation_prior_equations(subject.skeleton, problem.rotation_prior, pose)[0]
        gram = gram + RIDGE * jnp.eye(dofs, dtype=gram.dtype)
        leverage = jnp.sum((flat * factorise(gram).solve(flat.T).T).reshape(len(slopes), -1), 1)
        left = jnp.maximum(3.0 * slopes - leverage, 0.0)
        return weight * slopes * squared, weight * left

    frames = y.poses, problem.positions, used, problem.skin_features, problem.frame_weights
    squares, left = (jnp.sum(each, 0) for each in map_batches(of_frame, frames, BATCH_SIZE))
    left = jnp.maximum(left - 3.0, 0.0)
    common = jnp.sum(squares) / jnp.maximum(jnp.sum(left), 1.0)
    variance = jnp.clip(
        (squares + SHRINKAGE_WEIGHT * common) / (left + SHRINKAGE_WEIGHT),
        common / 9.0,
        common * problem.max_deviation_ratio**2,
    )
    return jnp.maximum(jnp.sqrt(variance), MIN_DEVIATION)
