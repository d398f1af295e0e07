"""`jaxcap limits project`: project a motion onto its joint limits."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np

from ...errors import InputError
from ...io.registry import write_motion
from ...limits.motion_projection import project_motion
from ..console.console import say, warn
from ..console.options import Flag, MotionSpec, OptionalBody, OptionalFile, OptionalUnit, arg
from ..outputs import check_motion, check_new
from .check import format_summary
from .motion_limits import LimitsFile, find_violations, read_motion_limits


@dataclass
class Project:
    """Project a motion onto joint limits: joints that violate the limits are rotated onto them, by the smallest angles
    and smoothly in time.

    Joints and frames within the limits do not change."""

    motion: MotionSpec
    limits: LimitsFile
    """Joint limits: a result of `jaxcap limits learn`, or a .cst or .asf file."""
    out: Annotated[Path, arg(aliases=("-o",), metavar="OUT")]
    """Output file for the motion, .bvh or .npz."""
    smoothness: Annotated[float, arg(metavar="SECONDS")] = 0.02
    """Time over which the corrections are smoothed, seconds. 0 projects every frame independently."""
    picture: OptionalFile = None
    """Output file for a picture of frames before and after, .png."""
    body: OptionalBody = None
    unit: OptionalUnit = None
    """Unit of the motion's lengths, if its file states none. Default: centimetres for BVH."""
    overwrite: Flag = False
    """Replace the results if they exist."""

    def run(self) -> None:
        check_motion(self.out, self.overwrite)
        if not 0 <= self.smoothness < np.inf:
            raise InputError(f"--smoothness is {self.smoothness:g}; it must be at least 0 seconds.")
        if self.picture is not None and self.picture.suffix.lower() != ".png":
            raise InputError(f"{self.picture}: the picture is a PNG file; give a name that ends in .png.")
        check_new(self.picture, self.overwrite)
        held = read_motion_limits(self.motion, self.limits, self.unit, self.body)
        say(format_summary(self.motion.name, held))
        fixed = project_motion(held.limits, held.skeleton, held.motion, self.smoothness)
        write_motion(self.out, held.skeleton, fixed)
        after = find_violations(held.skeleton, fixed, held.limits)
        say(f"written: {self.out}; joints are rotated by {held.degrees[held.is_violated].mean() if held.is_violated.any() else 0:.1f}° on average, {held.degrees.max():.1f}° at most")  # fmt: skip
        if after.is_violated.any():
            warn(format_summary(self.out.name, after))
        if self.picture is not None:
            from ...report.motion_strip import draw_strip

            title = f"{self.motion.name}: above the original, violations in red; below the projection"
            draw_strip(self.picture, held.skeleton, held.motion, fixed, held.is_violated, title)
            say(f"written: {self.picture}")
