"""A static pose that is given with the takes, and counts as much as all of their frames together."""

import numpy as np

from ...body.pose import Motion, take_poses
from ...errors import InputError
from ...observe.markers import MarkerFrames
from ..calibration.calibrate import Calibration
from ..segments.merge_takes import merge_takes
from ..segments.rigid_motion import displacement

#: largest displacement of a marker in a static trial, metres
MAX_SWAY = 0.08


def standing_frame(static: MarkerFrames) -> MarkerFrames:
    """Reduce a static trial to one frame with the median position of each marker.

    **Raises:** `InputError` if a marker moves by more than a standing person sways.
    """
    moved = displacement(static)
    if moved > MAX_SWAY:
        raise InputError(
            f"A marker of the static trial moves by {moved:.2f} m; give a trial in which the person stands still, or the frames of one in "
            "which the person does."
        )
    positions, seen = np.asarray(static.positions, float), np.asarray(static.visible)
    shown = np.asarray(np.any(seen, axis=0))
    places = np.zeros(positions.shape[1:])
    places[shown] = np.nanmedian(np.where(seen[..., None], positions, np.nan)[:, shown], axis=0)
    dtype = np.asarray(static.positions).dtype
    return MarkerFrames(places[None].astype(dtype), shown[None], static.labels, static.rate)


def prepend_static(static: MarkerFrames, frames: MarkerFrames) -> MarkerFrames:
    """Put the frame of a static trial before the frames of the takes. Raises `InputError` if the trial is not static."""
    merged = merge_takes([standing_frame(static), frames])
    return MarkerFrames(merged.positions, merged.visible, merged.labels, frames.rate)


def without_static(found: Calibration) -> Calibration:
    """Remove the first frame, which is that of the static pose, from the motion of a calibration."""
    rest = np.arange(1, len(found.motion))
    return found._replace(
        motion=Motion(take_poses(found.motion.poses, rest), found.motion.rate),
        residuals=found.residuals[1:],
        lost=found.lost[1:],
    )
