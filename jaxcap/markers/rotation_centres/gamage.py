"""The closed-form centre of concentric spheres (Gamage and Lasenby 2002), without its bias (Halvorsen 2003)."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from ...fit.alternate import iterate_until_converged
from ...geometry.linear import inverse_symmetric, solve_symmetric
from ..segments.relative_motion import RelativeMotion
from .centre_precision import independent_frame_fraction
from .estimator_parts import (
    MAX_REWEIGHTINGS,
    MIN_PRIOR_WEIGHT,
    CentreEstimate,
    geman_mcclure_weights,
    prior_weight,
)


class _ConcentricState(NamedTuple):
    """A centre and its covariance, with the weights and the noise variance for the next iteration."""

    centre: np.ndarray
    covariance: np.ndarray
    weights: np.ndarray
    noise: float
    ridge: float


def gamage_centre(motion: RelativeMotion, robust: bool = True, unbiased: bool = True) -> CentreEstimate:
    """Estimate the common centre of the spheres of the child's markers in the parent's frame.

    The sum over markers of the variance of `|v - c|^2` (Gamage and Lasenby 2002, eq. 5) has a minimum that
    is linear in `c`, but biased towards the markers: noise of variance `s^2` adds `2 s^2` to the matrix of
    each marker and `2 s^2` times its mean to the right side. Both are subtracted, with `s` from the
    residual, until convergence (Halvorsen 2003). Only the parent's frame has to be known.
    """
    c, covariance = concentric_centre(
        motion.child_markers,
        motion.child_visible,
        motion.child_weights,
        motion.prior_centre,
        motion.prior_deviation,
        robust,
        unbiased,
    )
    in_child = None
    if motion.rotations is not None and motion.translations is not None:
        child_positions = np.einsum("fba,fb->fa", motion.rotations, c - motion.translations)
        in_child = np.median(child_positions, axis=0)
    return CentreEstimate(c, in_child, covariance)


def concentric_centre(
    tracks: Float[np.ndarray, "F N 3"],
    visible: Bool[np.ndarray, "F N"],
    marker_weights: Float[np.ndarray, "N"],
    prior_centre: Float[np.ndarray, "3"],
    prior_deviation: float,
    robust: bool = True,
    unbiased: bool = True,
) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3 3"]]:
    """Estimate the common centre and its covariance from trajectories of N markers."""
    v = np.where(visible[..., None], tracks - prior_centre, 0.0)
    squares = np.sum(v * v, -1)

    def step(fit: _ConcentricState) -> _ConcentricState:
        weights, noise = fit.weights, fit.noise
        mass = np.maximum(weights.sum(0), 1e-300)
        mean = np.einsum("fn,fna->na", weights, v) / mass[:, None]
        centred = np.where(visible[..., None], v - mean, 0.0)
        matrix = np.einsum("fn,fna,fnb->ab", weights, centred, centred)
        side = 0.5 * np.einsum("fn,fna,fn->a", weights, centred, squares)
        if unbiased:
            # half of Halvorsen's terms, as the whole equation is halved
            matrix = matrix - noise * weights.sum() * np.eye(3)
            side = side - noise * np.einsum("fn,na->a", weights, mean)
        # with hardly any rotation all the variance may be noise: the prior then determines the centre
        lift = max(0.0, -np.linalg.eigvalsh(matrix)[0]) + MIN_PRIOR_WEIGHT * np.trace(matrix)
        c = solve_symmetric(matrix + (fit.ridge + lift) * np.eye(3), side)
        distances = np.linalg.norm(v - c, axis=-1)
        radius = np.einsum("fn,fn->n", weights, distances) / mass
        off = np.where(visible, distances - radius, 0.0)
        if robust:
            away = np.abs(off)
            some = np.where(visible, away, np.median(away[visible]))
            weights = visible * marker_weights * geman_mcclure_weights(some.ravel()).reshape(off.shape)
        noise, share = float((weights * off**2).sum() / weights.sum()), independent_frame_fraction(off)
        # per unit of the radius, as the rows are radii times distances
        ridge = prior_weight(
            abs(float(np.trace(matrix)) / 3), noise * float((radius**2).mean()), share, prior_deviation
        )
        # a row of the equation is radius times the deviation of the distance
        mean_square = float((weights.sum(0) @ radius**2) / weights.sum())
        covariance = noise * mean_square / share * inverse_symmetric(matrix + (ridge + lift) * np.eye(3))
        return _ConcentricState(c, covariance, weights, noise, ridge)

    start = _ConcentricState(np.zeros(3), np.eye(3), visible * marker_weights, 0.0, 0.0)
    fit = iterate_until_converged(step, start, 3 * MAX_REWEIGHTINGS, 1e-10, min_iterations=4)
    return prior_centre + fit.centre, fit.covariance
