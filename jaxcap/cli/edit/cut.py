"""`jaxcap edit cut`: a range of frames of a motion."""

from dataclasses import dataclass
from typing import Annotated

import numpy as np

from ...edit.clips import cut
from ...errors import InputError
from ..console.options import Flag, OptionalUnit, arg
from ..outputs import check_motion
from .files import Frames, MotionFile, OutMotion, frame_range, load_checked_motion, write_edited


@dataclass
class Cut:
    """Extract a range of frames of a motion, first and last frame included."""

    motion: MotionFile
    out: OutMotion
    """Output file for the frames, .bvh or .npz."""
    frames: Frames = None
    """First and last frame, counted from 0."""
    seconds: Annotated[tuple[float, float] | None, arg(metavar="FIRST LAST", help_behavior_hint="")] = None
    """First and last time, seconds, instead of --frames."""
    unit: OptionalUnit = None
    """Unit of the motion's lengths, if its file states none. Default: centimetres for BVH."""
    overwrite: Flag = False
    """Replace the motion if it exists."""

    def run(self) -> None:
        check_motion(self.out, self.overwrite)
        if (self.frames is None) == (self.seconds is None):
            raise InputError("Give either --frames or --seconds, and not both.")
        if self.seconds is not None and not np.isfinite(self.seconds).all():
            raise InputError(
                f"--seconds is {self.seconds[0]:g} {self.seconds[1]:g}; give two finite numbers."
            )
        skeleton, motion = load_checked_motion(self.motion, self.unit)
        frames = self.frames
        if self.seconds is not None:
            frames = (round(self.seconds[0] * motion.rate), round(self.seconds[1] * motion.rate))
        write_edited(self.out, skeleton, cut(motion, *frame_range(motion, frames, self.motion)))
