"""SCoRE, the symmetrical centre of rotation estimation (Ehrig, Taylor, Duda, Heller 2006)."""

from typing import NamedTuple

import numpy as np

from ...fit.alternate import iterate_until_converged
from ...geometry.linear import inverse_symmetric, solve_symmetric
from ..segments.relative_motion import RelativeMotion
from .centre_precision import independent_frame_fraction
from .estimator_parts import (
    MAX_REWEIGHTINGS,
    CentreEstimate,
    geman_mcclure_weights,
    prior_weight,
)


class _ScoreState(NamedTuple):
    """A centre in both frames, and the weights of frames and prior for the next iteration."""

    centres: np.ndarray
    weights: np.ndarray
    variance: float
    independent_fraction: float
    ridge: float


def score_centre(motion: RelativeMotion, robust: bool = True) -> CentreEstimate:
    """Estimate the centre that is fixed in both segments.

    It minimises the sum over frames of `|R c + t - p|^2` over its positions `p` in the parent and `c` in the
    child, exact without noise. With `robust`, outlier frames have lower weights. A weak prior at
    `motion.prior_centre` determines only what the frames leave open: along a hinge's axis, or where the joint
    hardly rotates. Noise in the frames rotates them about the centroids of their markers and biases the
    centre towards these. This bias is removed.

    **Raises:** `ValueError` where the child's frame is not known.
    """
    if motion.rotations is None or motion.translations is None:
        raise ValueError(
            "SCoRE needs the frames of both segments, but the child has fewer than three markers."
        )
    r, t = motion.rotations, motion.translations
    count = len(r)
    middle_child = np.median(np.einsum("fba,fb->fa", r, motion.prior_centre - t), axis=0)
    prior = np.concatenate([motion.prior_centre, middle_child])
    # relative to the prior, so that rounding errors and the prior's pull are small
    aside = np.einsum("fab,b->fa", r, prior[3:]) + t - prior[:3]

    def step(fit: _ScoreState) -> _ScoreState:
        weights = fit.weights
        side = np.concatenate([weights @ aside, -np.einsum("f,fba,fb->a", weights, r, aside)])
        found = prior + solve_symmetric(_normal_matrix(r, weights) + fit.ridge * np.eye(6), side)
        off = np.einsum("fab,b->fa", r, found[3:]) + t - found[:3]
        distances = np.linalg.norm(off, axis=1)
        if robust:
            weights = geman_mcclure_weights(distances)
        variance = float(weights @ distances**2) / (3 * weights.sum())
        share = independent_frame_fraction(off)
        ridge = prior_weight(float(weights.sum()), variance, share, motion.prior_deviation)
        return _ScoreState(found, weights, variance, share, ridge)

    ridge = prior_weight(float(count), 0.0, 1.0, motion.prior_deviation)
    fit = iterate_until_converged(
        step, _ScoreState(prior, np.ones(count), 0.0, 1.0, ridge), MAX_REWEIGHTINGS, 1e-9
    )
    covariance = (
        fit.variance
        / fit.independent_fraction
        * inverse_symmetric(_normal_matrix(r, fit.weights) + fit.ridge * np.eye(6))
    )
    found = _remove_bias(fit.centres, motion, fit.weights)
    return CentreEstimate(
        found[:3], found[3:], _add_prior_variance(covariance[:3, :3], r, fit.weights, motion.prior_deviation)
    )


def _remove_bias(centres: np.ndarray, motion: RelativeMotion, weights: np.ndarray) -> np.ndarray:
    """Remove the bias of the centre due to noise in the rotations.

    Noise of variance `n` about any axis adds `2 n` to `1 - R R^T`, with R the mean rotation, as if the joint
    also rotated about that segment's origin.
    """
    r, t = motion.rotations, motion.translations
    assert r is not None and t is not None
    of_parent, of_child = (2 * noise for noise in motion.rotation_noise)
    if of_parent + of_child == 0:
        return centres
    share = weights / weights.sum()
    mean, origin = np.einsum("f,fab->ab", share, r), share @ t
    pull = of_parent * centres[:3] + of_child * (centres[:3] - origin)
    values, vectors = np.linalg.eigh(np.eye(3) - mean @ mean.T)
    # no correction where most of the rotation is noise
    left = values - of_parent - of_child
    gains = np.where(left > 0.5 * values, 1 / np.maximum(left, 1e-300), 0.0)
    shift = vectors @ (gains * (vectors.T @ pull))
    # the position in the child follows from that in the parent: its rows of the normal equations
    return np.concatenate([centres[:3] + shift, centres[3:] + mean.T @ shift])


def _normal_matrix(r: np.ndarray, weights: np.ndarray) -> np.ndarray:
    mean = np.einsum("f,fab->ab", weights, r)
    whole = weights.sum() * np.eye(6)
    whole[:3, 3:], whole[3:, :3] = -mean, -mean.T
    return whole


def _add_prior_variance(
    covariance: np.ndarray, r: np.ndarray, weights: np.ndarray, prior_deviation: float
) -> np.ndarray:
    """Add the prior's variance along directions that no frame determines, up to rounding."""
    mean = np.einsum("f,fab->ab", weights / weights.sum(), r)
    values, vectors = np.linalg.eigh(np.eye(3) - mean @ mean.T)
    blind = vectors[:, values < 1e-8]
    return covariance + prior_deviation**2 * blind @ blind.T
