"""`jaxcap edit loop`: a periodic motion."""

from dataclasses import dataclass
from typing import Annotated

import numpy as np

from ...edit.clips import make_loop
from ...edit.transitions import find_loops
from ...errors import InputError, user_message
from ..console.console import print_table, say
from ..console.options import Flag, OptionalUnit, arg
from ..outputs import check_motion
from .files import Frames, MotionFile, OutMotion, load_checked_motion, write_edited

Seconds = Annotated[float | None, arg(metavar="SECONDS", help_behavior_hint="")]


@dataclass
class Loop:
    """Make a seamless loop from the most similar frames of a motion, or from given frames.

    The last frame has the pose and the velocity of the first; with --in-place also its position. Leave the last
    frame out in programs that repeat the loop."""

    motion: MotionFile
    out: OutMotion
    """Output file for the loop, .bvh or .npz."""
    frames: Frames = None
    """First and last frame of the loop. Default: the most similar frames."""
    blend: Annotated[float, arg(metavar="SECONDS")] = 0.2
    """Duration of the blend, seconds: the last frames of the loop are blended into the frames before its first one."""
    min_seconds: Seconds = None
    """Shortest loop to search for, seconds. Default: 0.5."""
    max_seconds: Seconds = None
    """Longest loop to search for, seconds. Default: the length of the motion."""
    in_place: Flag = False
    """Remove the translation and rotation from the first to the last frame, evenly over the loop."""
    unit: OptionalUnit = None
    """Unit of the motion's lengths, if its file states none. Default: centimetres for BVH."""
    overwrite: Flag = False
    """Replace the loop if it exists."""

    def run(self) -> None:
        check_motion(self.out, self.overwrite)
        for name, value in (
            ("--blend", self.blend),
            ("--min-seconds", self.min_seconds),
            ("--max-seconds", self.max_seconds),
        ):
            if value is not None and not 0 < value < np.inf:
                raise InputError(f"{name} is {value:g}; it must be above 0 seconds.")
        skeleton, motion = load_checked_motion(self.motion, self.unit)
        frames = max(2, round(self.blend * motion.rate))
        try:
            first, last = self.frames or self.find(skeleton, motion, frames)
            loop = make_loop(skeleton, motion, first, last, frames, self.in_place)
        except ValueError as error:
            raise InputError(f"{self.motion}: {user_message(error)}") from None
        goes = "stays in place"
        if not self.in_place:
            metres, degrees = float(np.linalg.norm(loop.travel.shift)), np.degrees(loop.travel.heading)
            goes = f"rotates by {degrees:.0f}° and moves by {metres:.2f} m"
        say(f"frames {first} to {last}: one cycle takes {(last - first) / motion.rate:.2f} s and {goes}")
        write_edited(self.out, skeleton, loop.motion)

    def find(self, skeleton, motion, frames: int) -> tuple[int, int]:
        least = round((0.5 if self.min_seconds is None else self.min_seconds) * motion.rate)
        most = len(motion) if self.max_seconds is None else round(self.max_seconds * motion.rate)
        found = find_loops(skeleton, motion, frames, max(least, frames), most, count=3)
        print_table(
            ["first", "last", "distance"],
            [[str(f.first + frames), str(f.second + frames), f"{1000 * f.distance:.0f} mm"] for f in found],
        )
        return found[0].first + frames, found[0].second + frames
