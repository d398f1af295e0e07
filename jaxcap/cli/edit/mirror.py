"""`jaxcap edit mirror`: left and right exchanged."""

from dataclasses import dataclass

from ...edit.mirror_motion import mirror
from ...errors import InputError, user_message
from ..console.options import Flag, OptionalUnit
from ..outputs import check_motion
from .files import MotionFile, OutMotion, load_checked_motion, write_edited


@dataclass
class Mirror:
    """Mirror a motion: exchange left and right."""

    motion: MotionFile
    out: OutMotion
    """Output file for the motion, .bvh or .npz."""
    unit: OptionalUnit = None
    """Unit of the motion's lengths, if its file states none. Default: centimetres for BVH."""
    overwrite: Flag = False
    """Replace the motion if it exists."""

    def run(self) -> None:
        check_motion(self.out, self.overwrite)
        skeleton, motion = load_checked_motion(self.motion, self.unit)
        try:
            found = mirror(skeleton, motion)
        except ValueError as error:
            raise InputError(f"{self.motion}: {user_message(error)}") from None
        write_edited(self.out, skeleton, found)
