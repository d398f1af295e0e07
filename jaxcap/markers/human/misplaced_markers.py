"""Markers that are not where their labels say: on another landmark, or far from it."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int

from ...observe.markers import MarkerFrames
from ..calibration.calibrate import Calibration
from ..motion.inverse_kinematics import marker_residuals_of_frames
from ..motion.label_matching import match_markers
from ..subject import Subject

#: least distance from the landmark, in standard deviations of the placement, and metres; markers that are farther than the second
#: distance, metres, are outliers of any placement
MIN_RATIO, MIN_OFFSET, MAX_OFFSET = 2.5, 0.025, 0.05
#: standard deviation of a placement, metres, from which on a marker is anywhere on its bone, such as one of a plate
WIDE_PLACEMENT = 0.05
#: standard deviations of the placement of misplaced markers, and of other markers on their bones, metres
MISPLACED_DEVIATION, NEIGHBOUR_DEVIATION = 0.15, 0.05
#: markers with at least this share of the largest distance are found at once, as others may be led astray by them
WORST_SHARE = 0.6


def constant_residuals(found: Calibration, frames: MarkerFrames) -> Float[np.ndarray, "M 3"]:
    """Compute the median residual of each marker in the rest frame of its bone, metres; zero for one that is never visible."""
    matched = match_markers(found.subject, frames)
    residuals = np.asarray(
        marker_residuals_of_frames(found.subject, found.motion.poses, matched.positions), float
    )
    seen = np.asarray(matched.seen) & ~found.lost[:, None]
    medians = np.zeros(residuals.shape[1:])
    for marker in np.flatnonzero(seen.any(0)):
        medians[marker] = np.median(residuals[seen[:, marker], marker], axis=0)
    return medians


def find_misplaced(
    residuals: Float[np.ndarray, "M 3"], bones: Int[np.ndarray, "M"], placements: Float[np.ndarray, "M"]
) -> Bool[np.ndarray, "M"]:
    """Find the markers with a constant residual on their bones that no usual placement explains, at most one at a landmark of each
    bone.

    A prior that is too narrow keeps such a marker away from where it is seen, and pulls the pose of its bone with it, so that
    other markers of the bone seem to be misplaced too.
    """
    offsets = np.linalg.norm(residuals, axis=1)
    far = offsets > np.clip(MIN_RATIO * placements, MIN_OFFSET, MAX_OFFSET)
    largest = np.zeros(int(bones.max(initial=0)) + 1)
    np.maximum.at(largest, bones, np.where(far, offsets, 0.0))
    is_worst = (offsets >= largest[bones]) | (placements >= WIDE_PLACEMENT)
    return far & is_worst & (offsets >= WORST_SHARE * largest.max())


def widen_placements(
    placements: Float[np.ndarray, "M"], bones: Int[np.ndarray, "M"], misplaced: Bool[np.ndarray, "M"]
) -> Float[np.ndarray, "M"]:
    """Return the standard deviations of placements with misplaced markers, metres.

    Those of the other markers on their bones become wider too: any of these may be the misplaced one, such as the other end of a
    bar with two markers, and the prior would turn the bone so that it is at its landmark.
    """
    doubtful = np.isin(bones, bones[misplaced & (placements < WIDE_PLACEMENT)])
    widened = np.where(doubtful, np.maximum(placements, NEIGHBOUR_DEVIATION), placements)
    return np.where(misplaced, MISPLACED_DEVIATION, widened)


def place_where_seen(
    template: Subject,
    found: Subject,
    residuals: Float[np.ndarray, "M 3"],
    misplaced: Bool[np.ndarray, "M"],
) -> Subject:
    """Move the misplaced markers of a template to where they are seen relative to the joints of their bones.

    From the landmark of its label such a marker would have no influence, as an outlier, and would stay there.
    """
    bones = np.asarray(template.bones)
    before, after = (np.asarray(subject.skeleton.centres, float)[bones] for subject in (template, found))
    seen = np.asarray(found.offsets, float) + residuals - after + before
    offsets = np.where(misplaced[:, None], seen, np.asarray(template.offsets, float))
    return eqx.tree_at(lambda s: s.offsets, template, jnp.asarray(offsets, template.offsets.dtype))
