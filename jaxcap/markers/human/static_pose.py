"""A static pose that is given with the takes, and counts as much as all of their frames together."""

import numpy as np
from jaxtyping import Float

from ...body.pose import Motion, take_poses
from ...errors import InputError
from ...observe.markers import MarkerFrames
from ..calibration.calibrate import Calibration
from ..segments.merge_takes import merge_takes
from ..segments.rigid_motion import displacement
from .describe_human import describe_frames

#: largest displacement of a marker in a static trial, metres
MAX_SWAY = 0.08
#: share of its frames in which a marker of a static trial may have the label of another one
EXCHANGED_SHARE = 0.1


def standing_frame(static: MarkerFrames) -> MarkerFrames:
    """Reduce a static trial to one frame with the median position of each marker.

    **Raises:** `InputError` if a marker moves by more than a standing person sways.
    """
    moved = displacement(static, EXCHANGED_SHARE)
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


def append_static(frames: MarkerFrames, static: MarkerFrames) -> MarkerFrames:
    """Put the frame of a static trial after the frames of the takes, which so keep their numbers.

    **Raises:** `InputError` if the trial is not static.
    """
    return merge_takes([frames, standing_frame(static)])


def static_weights(count: int, num_frames: int) -> Float[np.ndarray, "F"]:
    """Make weights of `count` frames, of which the last is that of a static pose, and `num_frames` of the others are chosen.

    The static pose counts as much as all of the chosen ones together.
    """
    weights = np.ones(count)
    weights[-1] = max(1, min(num_frames, count - 1))
    return weights


def without_static(found: Calibration) -> Calibration:
    """Remove the last frame, which is that of the static pose, from the motion of a calibration and its messages."""
    rest = np.arange(len(found.motion) - 1)
    before = describe_frames(found)
    shown = found._replace(residuals=found.residuals[:-1], lost=found.lost[:-1])
    after = list(describe_frames(shown))
    if found.lost[-1]:
        after.append(
            "No pose of the person explains the static trial, so it determines nothing; check its labels."
        )
    kept = tuple(message for message in found.motion_messages if message not in before)
    return shown._replace(
        motion=Motion(take_poses(found.motion.poses, rest), found.motion.rate),
        motion_messages=(*kept, *after),
        frame_indices=found.frame_indices[found.frame_indices < len(rest)],
    )
