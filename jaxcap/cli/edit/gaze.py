"""`jaxcap edit gaze`: the direction in which a person looks."""

from dataclasses import dataclass
from typing import Annotated

import numpy as np

from ...body.body import Body
from ...body.skeleton import Skeleton
from ...edit.gaze import look_at_target
from ...edit.gaze_line import (
    GazeLine,
    gaze_line_of_joint,
    gaze_line_of_vertices,
    gaze_shares,
    human_gaze_line,
)
from ...errors import InputError, user_message
from ...io.archives.limits import read_limits
from ..console.console import say, warn
from ..console.options import Flag, OptionalBody, OptionalFile, OptionalUnit, arg
from ..outputs import check_motion
from ..sources import load_body
from .files import Frames, MotionFile, OutMotion, frame_range, load_checked_motion, write_edited

OptionalVector = Annotated[tuple[float, float, float] | None, arg(metavar="X Y Z", help_behavior_hint="")]
#: distance of a target above which it is likely in another unit, metres
MAX_TARGET_DISTANCE = 50.0


@dataclass
class Gaze:
    """Make a person look at a point or in a direction: chest, neck and head take 10, 40 and 50 per cent of the
    rotation.

    Frames outside --frames do not change."""

    motion: MotionFile
    out: OutMotion
    """Output file for the motion, .bvh or .npz."""
    target: OptionalVector = None
    """Point to look at, in the coordinates of the motion, metres, y up."""
    direction: OptionalVector = None
    """Direction to look in, instead of --target."""
    frames: Frames = None
    """First and last frame of the gaze, including the fades. Default: all frames."""
    fade: Annotated[float, arg(metavar="SECONDS")] = 0.5
    """Duration of the fade at each end of the gaze, seconds."""
    max_angle: Annotated[float, arg(metavar="DEGREES")] = 90.0
    """Largest sum of the rotations of the joints, degrees."""
    joints: Annotated[str | None, arg(metavar="CHEST,NECK,HEAD", help_behavior_hint="")] = None
    """Joints that rotate. Default: the joints of chest, neck and head, found by their names."""
    body: OptionalBody = None
    gaze_line: Annotated[tuple[int, int] | None, arg(metavar="BACK FRONT", help_behavior_hint="")] = None
    """Vertices of --body at the back of the head and between the eyes, if the face of --body is not known. The face
    of `human` is known."""
    limits: OptionalFile = None
    """Joint limits to enforce: a result of `jaxcap limits learn`, or a .cst or .asf file."""
    unit: OptionalUnit = None
    """Unit of the motion's lengths, if its file states none. Default: centimetres for BVH."""
    overwrite: Flag = False
    """Replace the motion if it exists."""

    def run(self) -> None:
        self.check()
        body = None if self.body is None else load_body(self.body)[0]
        skeleton, motion = load_checked_motion(self.motion, self.unit, body)
        try:
            shares = self.shares(skeleton)
            if body is None:
                line = gaze_line_of_joint(skeleton, list(shares)[-1])
            else:
                line = self.line_of(body, list(shares)[-1])
            first, last = frame_range(motion, self.frames, self.motion)
            found = look_at_target(
                skeleton,
                motion,
                line,
                np.asarray(self.direction if self.target is None else self.target, float),
                shares,
                is_direction=self.target is None,
                first=first,
                last=last,
                fade=self.fade,
                max_angle=self.max_angle,
                limits=None if self.limits is None else read_limits(self.limits, skeleton),
            )
        except InputError:
            raise
        except ValueError as error:
            raise InputError(f"{self.motion}: {user_message(error)}") from None
        self.print_summary(found, first, last, shares)
        write_edited(self.out, skeleton, found.motion)

    def check(self) -> None:
        """Check that the options are compatible. Raises `InputError`."""
        check_motion(self.out, self.overwrite)
        if (self.target is None) == (self.direction is None):
            raise InputError("Give either --target or --direction, and not both.")
        if not 0 <= self.fade < np.inf:
            raise InputError(f"--fade is {self.fade:g}; it must be at least 0 seconds.")
        if not 0 < self.max_angle <= 180:
            raise InputError(
                f"--max-angle is {self.max_angle:g}; it must be above 0 and at most 180 degrees."
            )
        if self.gaze_line is not None and self.body is None:
            raise InputError("--gaze-line gives vertices of a body; give the body with --body.")
        if self.target is not None and np.linalg.norm(self.target) > MAX_TARGET_DISTANCE:
            warn(f"--target is {np.linalg.norm(self.target):.0f} m from the origin; it is in metres")

    def shares(self, skeleton: Skeleton) -> dict[str, float]:
        names = None if self.joints is None else [word.strip() for word in self.joints.split(",")]
        return gaze_shares(skeleton, names)

    def line_of(self, body: Body, head: str) -> GazeLine:
        line = (
            human_gaze_line(body)
            if self.gaze_line is None
            else gaze_line_of_vertices(body, *self.gaze_line, head)
        )
        if line is None:
            warn(
                f"{self.body}: the face of this body is not known, so the gaze is the front of the head joint; "
                "give --gaze-line to define it"
            )
            line = gaze_line_of_joint(body.skeleton, head)
        return line

    def print_summary(self, found, first: int, last: int, shares: dict[str, float]) -> None:
        full = found.magnitude == 1.0
        parts = ", ".join(f"{name} {100 * share:.0f} %" for name, share in shares.items())
        say(f"frames {first} to {last}, {int(full.sum())} of them with the full rotation: {parts}")
        if full.any():
            say(
                f"angle to the target: {found.before[full].mean():.1f}° before and {found.after[full].mean():.2f}° after"
            )
        if found.limited.any():
            warn(
                f"{int(found.limited.sum())} frames do not reach the target, as the rotation is limited to {self.max_angle:g}° or by joint limits; "
                f"the first is frame {int(np.argmax(found.limited))}"
            )
