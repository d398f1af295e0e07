"""Markers that are not where their labels say: on another landmark, or far from it."""

import numpy as np
from jaxtyping import Bool, Float

from ...observe.markers import MarkerFrames
from ..calibration.calibrate import Calibration
from ..motion.inverse_kinematics import marker_residuals_of_frames
from ..motion.label_matching import match_markers

#: least distance from the landmark, in standard deviations of the placement, and metres
MIN_RATIO, MIN_OFFSET = 2.5, 0.025
#: markers with at least this share of the largest distance are found at once, as others may be led astray by them
WORST_SHARE = 0.6


def find_misplaced(
    found: Calibration, frames: MarkerFrames, placements: Float[np.ndarray, "M"]
) -> Bool[np.ndarray, "M"]:
    """Find the markers with a constant residual on their bones that no usual placement explains.

    A prior that is too narrow holds such a marker away from where it is seen, and the poses with it.
    """
    matched = match_markers(found.subject, frames)
    residuals = np.asarray(
        marker_residuals_of_frames(found.subject, found.motion.poses, matched.positions), float
    )
    seen = np.asarray(matched.seen) & ~found.lost[:, None]
    offsets = np.zeros(len(placements))
    for marker in np.flatnonzero(seen.any(0)):
        offsets[marker] = np.linalg.norm(np.median(residuals[seen[:, marker], marker], axis=0))
    far = offsets > np.maximum(MIN_RATIO * placements, MIN_OFFSET)
    return far & (offsets >= WORST_SHARE * np.max(offsets, where=far, initial=0.0))
