"""`jaxcap edit join`: a transition from one motion into another."""

from dataclasses import dataclass
from typing import Annotated

import numpy as np

from ...edit.clips import cut, join
from ...edit.interpolation import resample
from ...edit.transitions import find_transitions
from ...errors import InputError
from ..console.console import say, warn
from ..console.options import Flag, MotionSpec, OptionalUnit, arg
from ..outputs import check_motion
from .files import OutMotion, load_checked_motion, write_edited
from .skeletons import check_same_skeleton

#: distance of the blended windows above which a jump is visible, metres
VISIBLE_JUMP = 0.15


@dataclass
class Join:
    """Append one motion to another, with a blend: the second continues where the first ends.

    The second motion is rotated about the vertical axis and translated along the floor. The floor has to be at the
    same height in both motions."""

    first: Annotated[MotionSpec, arg(metavar="FIRST")]
    second: Annotated[
        MotionSpec,
        arg(metavar="SECOND", help="Another motion of the same skeleton, in any format of FIRST."),
    ]
    out: OutMotion
    """Output file for the motion, .bvh or .npz."""
    blend: Annotated[float, arg(metavar="SECONDS")] = 0.3
    """Duration of the blend, seconds. 0 appends without a blend."""
    find_transition: Flag = False
    """Connect the motions at their most similar frames, not at the end of the first and the beginning of the
    second."""
    unit: OptionalUnit = None
    """Unit of the motions' lengths, if their files state none. Default: centimetres for BVH."""
    overwrite: Flag = False
    """Replace the motion if it exists."""

    def run(self) -> None:
        check_motion(self.out, self.overwrite)
        if not 0 <= self.blend < np.inf:
            raise InputError(f"--blend is {self.blend:g}; it must be at least 0 seconds.")
        skeleton, a = load_checked_motion(self.first, self.unit)
        other, b = load_checked_motion(self.second, self.unit)
        check_same_skeleton((self.first, skeleton), (self.second, other))
        if abs(a.rate - b.rate) > 1e-6 * a.rate:
            warn(f"{self.second}: it has {b.rate:g} frames per second and is resampled to {a.rate:g}")
            b = resample(b, a.rate)
        frames = round(self.blend * a.rate)
        if frames > min(len(a), len(b)):
            raise InputError(
                f"--blend is {self.blend:g} s, {frames} frames, and the motions have {len(a)} and {len(b)} frames; "
                "give a shorter blend."
            )
        window = max(frames, 1)
        if self.find_transition:
            found = find_transitions(skeleton, a, b, window)[0]
            a, b = cut(a, 0, found.first + window - 1), cut(b, found.second)
            say(
                f"from frame {found.first} of {self.first.name} to frame {found.second} of {self.second.name}, "
                f"joints {1000 * found.distance:.0f} mm apart"
            )
        else:
            found = find_transitions(skeleton, cut(a, len(a) - window), cut(b, 0, window - 1), window)[0]
        if found.distance > VISIBLE_JUMP:
            warn(
                f"joints are {1000 * found.distance:.0f} mm apart at the transition; give a longer --blend, or --find-transition to "
                "search for similar frames"
            )
        write_edited(self.out, skeleton, join(skeleton, a, b, frames))
