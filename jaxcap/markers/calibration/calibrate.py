"""Calibration of a subject: all poses, joint centres and marker positions together (the global technique)."""

import logging
from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float
from threadpoolctl import threadpool_limits

from ...arguments import checked
from ...body.pose import Motion, take_poses
from ...body.symmetry import bone_pairs
from ...compiled import forget_many_compiled
from ...energy.check_energies import UserTerms, sum_user_terms
from ...observe.markers import MarkerFrames
from ..motion.inverse_kinematics import marker_residuals_of_frames, solve_markers
from ..motion.label_matching import match_markers
from ..subject import Subject, marker_body
from .bundle_adjustment import AdjustmentResult, bundle_adjust
from .calibration_parameters import AbstractTemplatePrior, TemplatePrior, solved_joints
from .calibration_problem import (
    MAX_DEVIATION_RATIO,
    CalibrationEstimate,
    CalibrationProblem,
    make_calibration_problem,
)
from .effective_frames import correlation_time
from .frame_selection import choose_frames
from .observability import (
    ImpreciseDirection,
    describe_precision,
    find_imprecise_directions,
    shared_covariance,
)
from .rotation_prior import with_wide_posture
from .soft_tissue import MAX_SLIDING, further_features, shift_variances

_LOG = logging.getLogger(__name__)

#: robust weight, of one, below which a marker in a frame is an outlier
MIN_INLIER_WEIGHT = 0.05
#: sliding of a marker above which it is reported, metres
MIN_REPORTED_SLIDING = 0.005


class Calibration(NamedTuple):
    """A calibrated subject, its motion through all frames, and its precision.

    Markers are in the subject's order; `s` are the shared unknowns of
    `jaxcap.markers.calibration.calibration_parameters`.
    """

    subject: Subject
    motion: Motion
    #: metres, NaN where not visible
    residuals: Float[np.ndarray, "F M"]
    #: frames with too few markers or without a pose that fits
    lost: Bool[np.ndarray, "F"]
    #: covariance of `s`, metres squared, with the template's prior
    covariance: Float[np.ndarray, "S S"]
    #: root mean square sliding of each marker on its bone as joints rotate, metres
    slides: Float[np.ndarray, "M"]
    #: directions in which centres are imprecise, or determined by the template alone
    imprecise_directions: tuple[ImpreciseDirection, ...]
    #: messages on what the data determine badly or not at all, in sentences
    precision_messages: tuple[str, ...]
    #: messages on sliding skin, lost frames and markers that are never visible
    motion_messages: tuple[str, ...]
    #: robust cost after every step, in squared standard deviations; it rises when variances are updated
    history: tuple[float, ...]
    #: the joints with solved centres, in the order of `s`
    joints: tuple[int, ...]
    #: indices of the frames that the subject was calibrated with
    frame_indices: Float[np.ndarray, "C"]
    converged: bool
    #: number of the chosen frames with the information of one with independent errors
    frames_per_observation: float
    #: the last fit's problem and its solution; `solve_calibration(problem, estimate)` has derivatives, in float64 only
    problem: CalibrationProblem
    estimate: CalibrationEstimate

    @property
    def messages(self) -> tuple[str, ...]:
        """All messages, in sentences."""
        return self.precision_messages + self.motion_messages


@checked
def calibrate(
    frames: MarkerFrames,
    subject: Subject,
    motion: Motion | None = None,
    *,
    robust: bool = True,
    skin: bool = True,
    symmetry: Sequence[tuple[str, str]] = (),
    num_frames: int = 100,
    template_prior: AbstractTemplatePrior = TemplatePrior(),
    frames_per_observation: float = 1.0,
    frame_weights: Float[np.ndarray, "F"] | None = None,
    max_deviation_ratio: float = MAX_DEVIATION_RATIO,
    max_steps: int = 240,
    terms: UserTerms = (),
) -> Calibration:
    """Calibrate the subject's skeleton and the marker positions on it, starting from a template.

    **Arguments:** `frames` with the template's labels in any order; `subject`, the template: its bones may
    be a tenth too long or short, and its markers off by centimetres; `motion` of the template through the
    frames, by default solved for; `robust`: outliers have low weights; `skin`: markers may slide on their
    bones as joints rotate, where residuals show it; `symmetry`, pairs of joint names with bones of exactly
    equal length; `num_frames` frames are chosen, as different as possible, and at the end all frames are solved;
    `template_prior` in the template, the prior of what the frames do not determine; `frames_per_observation`,
    how many of the chosen frames have the information of one with independent errors (for the covariance, at
    least as many as follows from the autocorrelation of the residuals); `frame_weights`, how many times the observations of
    each frame count, by default once: frames that count more, such as one of a static pose, are always chosen;
    `max_deviation_ratio`, the largest deviation of
    a marker as a multiple of that of all; `max_steps` at most; `terms`,
    energies of your own, in units of a log-likelihood, which see the subject's skeleton with its markers as
    vertices.

    **Raises:** `ValueError` where frames and template share no label, fewer than three markers are ever
    visible, a name in `symmetry` is not a joint's, or `frame_weights` are not one number above zero for each frame.
    """
    forget_many_compiled()
    # threads of BLAS and of XLA wait for each other, and the matrices of frames are small
    with threadpool_limits(1, "blas"):
        sum_user_terms("calibrate", terms, marker_body(subject))
        _check_frame_weights(frame_weights, len(frames))
        matched = match_markers(subject, frames)
        used = np.asarray(matched.seen) & (np.asarray(subject.weights) > 0)
        if used.any(0).sum() < 3:
            raise ValueError(
                f"Only {int(used.any(0).sum())} markers are ever visible; a body needs at least three, and "
                "several on each bone."
            )
        template, pairs = subject, _symmetric_bones(subject, symmetry)
        usable, explained = used.sum(1) >= 3, used
        if motion is None:
            motion, usable, explained = _solve_motion(template, frames, used, terms)
        while True:
            chosen = choose_frames(subject, motion.poses, explained, usable, num_frames)
            if frame_weights is not None:
                chosen = np.union1d(chosen, np.flatnonzero((frame_weights > 1.0) & usable))
            joints = solved_joints(template, np.atleast_1d(explained[chosen].any(0)))
            positions, seen = matched.positions[chosen], jnp.asarray(explained[chosen])
            again = subject is template and not explained[used].all()
            _LOG.info("fitting %d frames jointly%s", len(chosen), ", with rough tolerances" if again else "")
            # a rough fit is enough to find swapped labels
            problem = make_calibration_problem(
                template, positions, seen, joints, pairs, template_prior, robust=robust, terms=terms
            )
            problem = with_frames_per_observation(problem, frames_per_observation)
            if frame_weights is not None:
                weights = jnp.asarray(frame_weights[chosen], problem.frame_weights.dtype)
                problem = eqx.tree_at(lambda p: p.frame_weights, problem, weights)
            ratio = jnp.asarray(max_deviation_ratio, problem.max_deviation_ratio.dtype)
            problem = eqx.tree_at(lambda p: p.max_deviation_ratio, problem, ratio)
            fit = bundle_adjust(
                problem,
                subject,
                take_poses(motion.poses, chosen),
                allow_sliding=skin,
                max_steps=max_steps,
                rough=again,
            )
            subject, poses = fit.problem.subject(fit.estimate), fit.estimate.poses
            if not again:
                break
            # the subject is known better now, and so are the swapped labels
            motion, usable, explained = _solve_motion(
                _subject_with_sliding_variance(fit), frames, used, terms
            )
        best = _subject_with_sliding_variance(fit)
        slid = _sliding_variances(fit)
        solved = solve_markers(best, frames, terms=terms)
        explained = used & (solved.weights >= MIN_INLIER_WEIGHT)
        lasting = _frames_per_observation(best, solved.motion, matched, explained, chosen)
        share = max(frames_per_observation, lasting)
        _LOG.info("computing the covariance of the subject, as if %.1f frames were one observation", share)
        unsure = _with_given_prior(with_frames_per_observation(fit.problem, share), template_prior)
        known = shared_covariance(*with_unsure_sliding(unsure, fit.estimate))
        hardly = find_imprecise_directions(best, known, joints)
        messages = (
            *_describe_sliding(best, slid),
            *_describe_excessive_sliding(best, fit.problem),
            *solved.messages,
        )
        if not fit.converged:
            messages += (f"The fit did not converge in {max_steps} steps; allow more steps.",)
        return Calibration(
            best,
            solved.motion,
            solved.residuals,
            solved.lost,
            known.covariance,
            np.sqrt(3.0 * slid),
            tuple(hardly),
            tuple(describe_precision(best, known, poses, joints, hardly)),
            messages,
            fit.history,
            joints,
            chosen,
            fit.converged,
            share,
            fit.problem,
            fit.estimate,
        )


def _check_frame_weights(weights: Float[np.ndarray, "F"] | None, count: int) -> None:
    if weights is not None and (len(weights) != count or not (np.isfinite(weights) & (weights > 0)).all()):
        raise ValueError(
            f"`frame_weights` has {len(weights)} numbers for {count} frames; give one finite number above zero for each frame."
        )


def with_frames_per_observation(problem: CalibrationProblem, share: float) -> CalibrationProblem:
    """Make a problem in which `share` frames have the information of one."""
    value = jnp.asarray(share, problem.frames_per_observation.dtype)
    return eqx.tree_at(lambda p: p.frames_per_observation, problem, value)


def _with_given_prior(problem: CalibrationProblem, prior: AbstractTemplatePrior) -> CalibrationProblem:
    """Replace the deviations that the data chose for the prior by the given ones, as that choice is uncertain itself."""
    given = jnp.asarray(prior.precision(problem.template, problem.joints), problem.prior.dtype)
    return eqx.tree_at(lambda p: p.prior, problem, given)


def with_unsure_sliding(
    problem: CalibrationProblem, estimate: CalibrationEstimate
) -> tuple[CalibrationProblem, CalibrationEstimate]:
    """Add the sliding that no fit shows, and take no bone for one with less sliding than the average of all markers.

    The few markers of a bone hardly show how far all of them slide together.
    """
    if not estimate.slides.size:
        return problem, estimate
    features, dtype = np.asarray(problem.skin_features, float), problem.skin_features.dtype
    further = jnp.asarray(further_features(problem.subject(estimate), estimate.poses, features), dtype)
    usual = jnp.sqrt(jnp.mean(problem.slide_deviations**2))
    own = jnp.maximum(problem.slide_deviations, usual)
    count, markers = further.shape[2], own.shape[1]
    more = jnp.broadcast_to(jnp.sqrt(jnp.mean(own**2, 0)), (count, markers))
    replaced = jnp.concatenate([problem.skin_features, further], 2), jnp.concatenate([own, more])
    problem = eqx.tree_at(lambda p: (p.skin_features, p.slide_deviations), problem, replaced)
    slides = jnp.concatenate([estimate.slides, jnp.zeros((count, markers, 3), estimate.slides.dtype)])
    return problem, CalibrationEstimate(estimate.poses, estimate.shared, slides)


def _frames_per_observation(subject: Subject, motion: Motion, matched, explained, chosen) -> float:
    """Estimate how many of the chosen frames have the information of one, at least 1, from a motion through all frames."""
    residuals = np.asarray(marker_residuals_of_frames(subject, motion.poses, matched.positions), float)
    independent = len(residuals) / correlation_time(residuals, explained)
    return max(1.0, len(chosen) / independent)


def _describe_sliding(subject: Subject, variances: Float[np.ndarray, "M"]) -> list[str]:
    """Describe the markers with the most skin sliding in a sentence."""
    far = 3.0 * np.sqrt(3.0 * variances)
    most = [marker for marker in np.argsort(-far)[:5] if far[marker] > MIN_REPORTED_SLIDING]
    if not most:
        return []
    each = ", ".join(f"{subject.labels[marker]} ({1000 * far[marker]:.0f} mm)" for marker in most)
    return [f"Skin slides on its bones as the joints rotate; the markers with the most sliding are {each}."]


def _describe_excessive_sliding(subject: Subject, problem: CalibrationProblem) -> list[str]:
    """Describe bones with markers that would have to slide more than soft tissue does."""
    at_limit = np.any(np.asarray(problem.slide_deviations) >= 0.99 * MAX_SLIDING, axis=0)
    names = [subject.skeleton.names[bone] for bone in np.unique(np.asarray(subject.bones)[at_limit])]
    if not names:
        return []
    return [
        f"Markers of {', '.join(names)} would have to slide by more than {1000 * MAX_SLIDING:.0f} mm per radian, more than "
        "soft tissue does. Check if all markers of each of these are on one bone."
    ]


def _solve_motion(subject: Subject, frames: MarkerFrames, used: Bool[np.ndarray, "F M"], terms: UserTerms):
    """Solve the subject's motion; return it with the explained frames and the mask of inlier markers.

    The subject is not known yet, so rotations have a wide prior, about rest.
    Markers with a weight below `MIN_INLIER_WEIGHT`, most likely with swapped labels, are outliers.
    """
    solved = solve_markers(with_wide_posture(subject), frames, terms=terms)
    return solved.motion, ~solved.lost, used & ((solved.weights >= MIN_INLIER_WEIGHT) | solved.lost[:, None])


def _sliding_variances(fit: AdjustmentResult) -> Float[np.ndarray, "M"]:
    return shift_variances(
        np.asarray(fit.problem.skin_features, float), np.asarray(fit.estimate.slides, float)
    )


def _subject_with_sliding_variance(fit: AdjustmentResult) -> Subject:
    """Return the fitted subject, with the variance of skin sliding added to the markers' variances.

    The sliding of skin in other frames is unknown.
    """
    variances = _sliding_variances(fit)
    found = fit.problem.deviations
    deviations = jnp.sqrt(found**2 + jnp.asarray(variances, found.dtype))
    return eqx.tree_at(lambda s: s.deviations, fit.problem.subject(fit.estimate), deviations)


def _symmetric_bones(subject: Subject, symmetry: Sequence[tuple[str, str]]) -> tuple[tuple[int, int], ...]:
    """Keep the pairs of bones with both ends determined by motion."""
    skeleton = subject.skeleton
    for name in (name for pair in symmetry for name in pair):
        if name not in skeleton.names:
            raise ValueError(
                f"There is no joint '{name}' for a symmetric pair; the skeleton has "
                f"{', '.join(skeleton.names)}."
            )
    pairs = [(skeleton.index(left), skeleton.index(right)) for left, right in symmetry]
    kept = bone_pairs(skeleton, np.array(pairs, int).reshape(-1, 2))
    # the centre of a joint that does not rotate is undetermined along its line
    stiff = np.isin(np.array(skeleton.kinds), ["fixed", "translate"])
    ends = np.array([stiff[j] or stiff[skeleton.parents[j]] for j in range(skeleton.num_joints)])
    return tuple((int(a), int(b)) for a, b in kept if not ends[a] and not ends[b])
