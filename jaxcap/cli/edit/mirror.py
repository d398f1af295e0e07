"""`jaxcap edit mirror`: left and right exchanged."""

from dataclasses import dataclass

from ...edit.mirror_motion import mirror
from ...errors import InputError, sentence_of
from ..console.options import Flag, OptionalUnit
from ..outputs import check_motion
from .files import MotionFile, OutMotion, read_edited, save


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
        skeleton, motion = read_edited(self.motion, self.unit)
        try:
            found = mirror(skeleton, motion)
        except ValueError as error:
            raise InputError(f"{self.motion}: {sentence_of(error)}") from None
        save(self.out, skeleton, found)
