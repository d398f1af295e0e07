"""`jaxcap edit resample`: a motion at another rate."""

from dataclasses import dataclass
from typing import Annotated

from ...edit.interpolation import resample
from ...errors import InputError, user_message
from ..console.options import Flag, OptionalUnit, arg
from ..outputs import check_motion
from .files import MotionFile, OutMotion, load_checked_motion, write_edited

#: maximum number of frames, as a limit of memory
MAX_FRAMES = 1_000_000


@dataclass
class Resample:
    """Resample a motion to another rate; new frames are interpolated."""

    motion: MotionFile
    out: OutMotion
    """Output file for the motion, .bvh or .npz."""
    rate: Annotated[float, arg(metavar="RATE")]
    """New rate, frames per second."""
    unit: OptionalUnit = None
    """Unit of the motion's lengths, if its file states none. Default: centimetres for BVH."""
    overwrite: Flag = False
    """Replace the motion if it exists."""

    def run(self) -> None:
        check_motion(self.out, self.overwrite)
        skeleton, motion = load_checked_motion(self.motion, self.unit)
        frames = len(motion) / motion.rate * self.rate
        if frames > MAX_FRAMES:
            raise InputError(
                f"--rate is {self.rate:g}; this gives {frames:.3g} frames, and the maximum is {MAX_FRAMES}."
            )
        try:
            found = resample(motion, self.rate)
        except ValueError as error:
            raise InputError(f"--rate: {user_message(error)}") from None
        write_edited(self.out, skeleton, found)
