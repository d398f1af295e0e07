"""A subject from frames: all poses, joint centres and marker places together (the global technique)."""

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
from ...body.symmetry import bones_of
from ...energy.check import OwnTerms, own_terms
from ...observe import MarkerFrames
from ..motion.inverse_kinematics import solve_markers
from ..motion.label_matching import match_markers
from ..subject import Subject, marker_body
from .bundle_adjustment import Fit, adjust
from .calibration_parameters import Trust, solved_joints
from .frame_selection import choose_frames
from .observability import Hardly, describe_precision, hardly_known, shared_covariance
from .problem import make_calibration_problem
from .soft_tissue import shift_variances

_LOG = logging.getLogger(__name__)

#: what a marker counts, of one, that no pose explains
FAR = 0.05
#: metres that a marker slides to be told
SLIDING = 0.005


class Calibration(NamedTuple):
    """A calibrated subject, its motion through all frames, and how well it is known.

    Markers are in the subject's order; `s` are the shared unknowns of `jaxcap.markers.calibration.calibration_parameters`.
    """

    subject: Subject
    motion: Motion
    #: metres, NaN where not seen
    residuals: Float[np.ndarray, "F M"]
    #: of `s`, metres squared, with what the template was trusted
    covariance: Float[np.ndarray, "S S"]
    #: root mean square of how far each marker slides on its bone as joints turn, metres
    slides: Float[np.ndarray, "M"]
    #: directions in which centres are hardly known, or known by the template alone
    hardly: tuple[Hardly, ...]
    #: what the data do not tell, or hardly, in sentences
    told: tuple[str, ...]
    #: robust cost after every step, in squared standard deviations; a rise marks new variances
    history: tuple[float, ...]
    #: the joints whose centres were solved for, in the order of `s`
    joints: tuple[int, ...]
    #: the frames that the subject was made of
    frames: Float[np.ndarray, "C"]
    converged: bool


@checked
def calibrate(
    frames: MarkerFrames,
    subject: Subject,
    motion: Motion | None = None,
    *,
    robust: bool = True,
    skin: bool = True,
    symmetry: Sequence[tuple[str, str]] = (),
    count: int = 100,
    trust: Trust = Trust(),
    steps: int = 240,
    terms: OwnTerms = (),
) -> Calibration:
    """The performer's skeleton and the places of the markers on it, from a template.

    **Arguments:** `frames` with the template's labels in any order; `subject`, the template, whose
    bones may be a tenth too long or short and whose markers centimetres off; `motion` of the template
    through the frames, solved for where not given; `robust`: what is far off counts little; `skin`:
    markers may slide on their bones as joints turn, where residuals show that they do;
    `symmetry`, pairs of names of joints whose bones are equally long, kept exactly; `count` frames are
    chosen, as different as can be, and all are solved in the end; `trust` in the template, which
    decides what the frames do not tell; `steps` at most; `terms`, energies of your own, in units of a log-likelihood, which see
    the subject's skeleton with its markers for vertices.

    **Raises:** `ValueError` where frames and template share no label, fewer than three markers are ever
    seen, or a name in `symmetry` is not a joint's.
    """
    # threads of BLAS and those of XLA wait for each other, and matrices of frames are small
    with threadpool_limits(1, "blas"):
        return _calibrate(frames, subject, motion, robust, skin, symmetry, count, trust, steps, terms)


def _calibrate(frames, subject, motion, robust, skin, symmetry, count, trust, steps, terms) -> Calibration:
    own_terms("calibrate", terms, marker_body(subject))
    matched = match_markers(subject, frames)
    used = np.asarray(matched.seen) & (np.asarray(subject.weights) > 0)
    if used.any(0).sum() < 3:
        raise ValueError(
            f"Only {int(used.any(0).sum())} markers are ever seen; a body takes three at the least, and several a bone."
        )
    template, pairs = subject, _pairs(subject, symmetry)
    usable, explained = used.sum(1) >= 3, used
    if motion is None:
        motion, usable, explained = _followed(template, frames, used)
    while True:
        chosen = choose_frames(subject, motion.poses, explained, usable, count)
        joints = solved_joints(template, np.atleast_1d(explained[chosen].any(0)))
        places, seen = matched.places[chosen], jnp.asarray(explained[chosen])
        again = subject is template and not explained[used].all()
        _LOG.info("fitting %d frames together%s", len(chosen), ", roughly" if again else "")
        # to find exchanged labels a rough fit will do
        problem = make_calibration_problem(
            template, places, seen, joints, pairs, trust, robust=robust, terms=terms
        )
        fit = adjust(problem, subject, take_poses(motion.poses, chosen), skin=skin, steps=steps, rough=again)
        subject, poses = fit.problem.subject(fit.estimate), fit.estimate.poses
        if not again:
            break
        # of whom the markers are is known better now, and so is which of them were exchanged
        motion, usable, explained = _followed(_measured(fit), frames, used)
    _LOG.info("computing how well the subject is known")
    known = shared_covariance(fit.problem, fit.estimate)
    best = _measured(fit)
    slid = _slid(fit)
    solved = solve_markers(best, frames, terms=terms)
    hardly = hardly_known(best, known, joints)
    told = (*describe_precision(best, known, poses, joints, hardly), *_on_skin(best, slid), *solved.told)
    if not fit.converged:
        told += (f"The fit had not converged after {steps} steps; allow more.",)
    return Calibration(
        best,
        solved.motion,
        solved.residuals,
        known.covariance,
        np.sqrt(3.0 * slid),
        tuple(hardly),
        told,
        fit.history,
        joints,
        chosen,
        fit.converged,
    )


def _on_skin(subject: Subject, variances: Float[np.ndarray, "M"]) -> list[str]:
    """A sentence about the markers that slide furthest."""
    far = 3.0 * np.sqrt(3.0 * variances)
    most = [marker for marker in np.argsort(-far)[:5] if far[marker] > SLIDING]
    if not most:
        return []
    each = ", ".join(f"{subject.labels[marker]} by {1000 * far[marker]:.0f} mm" for marker in most)
    return [f"Skin slides on its bones as the joints turn, the most under {each}."]


def _followed(subject: Subject, frames: MarkerFrames, used: Bool[np.ndarray, "F M"]):
    """The subject's motion, the frames that it explains, and the markers there that count: of those that
    are `FAR` off, exchanged by their labels most likely, nothing is to be learned."""
    solved = solve_markers(subject, frames)
    return solved.motion, ~solved.lost, used & ((solved.weights >= FAR) | solved.lost[:, None])


def _slid(fit: Fit) -> Float[np.ndarray, "M"]:
    return shift_variances(np.asarray(fit.problem.features, float), np.asarray(fit.estimate.slides, float))


def _measured(fit: Fit) -> Subject:
    """With the deviations of markers on skin, as nobody knows of other frames how it slides there."""
    variances = _slid(fit)
    found = fit.problem.deviations
    deviations = jnp.sqrt(found**2 + jnp.asarray(variances, found.dtype))
    return eqx.tree_at(lambda s: s.deviations, fit.problem.subject(fit.estimate), deviations)


def _pairs(subject: Subject, symmetry: Sequence[tuple[str, str]]) -> tuple[tuple[int, int], ...]:
    """The pairs that end bones of which both ends are told apart by motion."""
    skeleton = subject.skeleton
    for name in (name for pair in symmetry for name in pair):
        if name not in skeleton.names:
            raise ValueError(
                f"There is no joint '{name}' to be symmetrical; the skeleton has {', '.join(skeleton.names)}."
            )
    pairs = [(skeleton.index(left), skeleton.index(right)) for left, right in symmetry]
    kept = bones_of(skeleton, np.array(pairs, int).reshape(-1, 2))
    # nothing tells where along its line the centre of a joint lies that does not turn
    stiff = np.isin(np.array(skeleton.kinds), ["fixed", "translate"])
    ends = np.array([stiff[j] or stiff[skeleton.parents[j]] for j in range(skeleton.num_joints)])
    return tuple((int(a), int(b)) for a, b in kept if not ends[a] and not ends[b])
