"""`jaxcap limits project`: project a motion onto its joint limits."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np

from ...errors import InputError
from ...io.registry import write_motion
from ...limits.project import project_motion
from ..console.console import say, warn
from ..console.options import Flag, MotionSpec, OptionalBody, OptionalFile, OptionalUnit, arg
from ..outputs import check_motion, check_new
from .check import summary
from .motion_limits import LimitsFile, judge, read_motion_limits


@dataclass
class Project:
    """Turn the joints of a motion that are beyond limits back into them, by the shortest way and smoothly.

    Joints and frames that are allowed stay as they are."""

    motion: MotionSpec
    limits: LimitsFile
    """Limits that `jaxcap limits learn` wrote, or a .cst or .asf file."""
    out: Annotated[Path, arg(aliases=("-o",), metavar="OUT")]
    """The motion, .bvh or .npz."""
    smoothness: Annotated[float, arg(metavar="SECONDS")] = 0.02
    """Over which turns back are drawn together; 0 treats every frame by itself."""
    picture: OptionalFile = None
    """A PNG file with frames before and after."""
    body: OptionalBody = None
    unit: OptionalUnit = None
    """Unit of the motion's lengths, in place of what it says."""
    overwrite: Flag = False
    """Replace results where they are there."""

    def run(self) -> None:
        check_motion(self.out, self.overwrite)
        if not 0 <= self.smoothness < np.inf:
            raise InputError(f"--smoothness is {self.smoothness:g}; it must be at least 0 seconds.")
        if self.picture is not None and self.picture.suffix.lower() != ".png":
            raise InputError(f"{self.picture}: the picture is a PNG file; give a name that ends in .png.")
        check_new(self.picture, self.overwrite)
        held = read_motion_limits(self.motion, self.limits, self.unit, self.body)
        say(summary(self.motion.name, held))
        fixed = project_motion(held.limits, held.skeleton, held.motion, self.smoothness)
        write_motion(self.out, held.skeleton, fixed)
        after = judge(held.skeleton, fixed, held.limits)
        say(f"written: {self.out}; joints are turned back by {held.degrees[held.beyond].mean() if held.beyond.any() else 0:.1f}° on average, {held.degrees.max():.1f}° at most")  # fmt: skip
        if after.beyond.any():
            warn(summary(self.out.name, after))
        if self.picture is not None:
            from ...report.motion_strip import draw_strip

            title = f"{self.motion.name}: above as it was, in red what is beyond limits; below within them"
            draw_strip(self.picture, held.skeleton, held.motion, fixed, held.beyond, title)
            say(f"written: {self.picture}")
