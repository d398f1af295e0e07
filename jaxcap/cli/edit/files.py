"""Reading and writing of motions for the verbs of `jaxcap edit`."""

from pathlib import Path
from typing import Annotated

from ...body.body import Body
from ...body.pose import Motion
from ...body.skeleton import Skeleton
from ...errors import InputError
from ...io.registry import SKELETON_READERS, read_skeleton, write_motion
from ...io.skinned.clip import suffix_of
from ..console.console import pluralise, say
from ..console.options import MotionSpec, arg
from ..convert.conversion_kind import KNOWN_UNIT_SUFFIXES
from ..motions import extent, load_body_motion, load_motion

MotionFile = MotionSpec
OutMotion = Annotated[Path, arg(aliases=("-o",), metavar="OUT")]
Frames = Annotated[tuple[int, int] | None, arg(metavar="FIRST LAST", help_behavior_hint="")]

#: minimum and maximum extent of a person's joints, metres
REACH = (0.2, 5.0)


def load_checked_motion(path: Path, unit: str | None, body: Body | None = None) -> tuple[Skeleton, Motion]:
    """Read a motion that has frames and a person's size; if `body` is given, its skeleton replaces that of
    the file, which may have none. Raises `InputError`."""
    if unit and suffix_of(path) in KNOWN_UNIT_SUFFIXES:
        raise InputError(f"{path}: '{suffix_of(path)}' files have a known unit; omit --unit {unit}.")
    if body is None:
        skeleton, motion = load_motion(path, unit)
        check_extent(path, skeleton)
    else:
        # the size is checked before the skeleton is compared with the body's
        if suffix_of(path) in SKELETON_READERS and suffix_of(path) not in KNOWN_UNIT_SUFFIXES:
            check_extent(path, read_skeleton(path, unit))
        skeleton, motion = body.skeleton, load_body_motion(body, path, unit)
    if len(motion) == 0:
        raise InputError(f"{path}: this motion has no frames.")
    return skeleton, motion


def check_extent(path: Path, skeleton: Skeleton) -> None:
    """Check by the extent of the joints that a motion was read in the right unit. Raises `InputError`."""
    reach = extent(skeleton)
    if skeleton.num_joints > 1 and not REACH[0] < reach < REACH[1]:
        raise InputError(
            f"{path}: the skeleton of this motion extends over {reach:.4g} m at rest; "
            "give the unit of its lengths with --unit."
        )


def frame_range(motion: Motion, frames: tuple[int, int] | None, path: Path) -> tuple[int, int]:
    """Return the first and the last frame, of the whole motion if none are given. Raises `InputError`."""
    first, last = (0, len(motion) - 1) if frames is None else frames
    if not 0 <= first <= last < len(motion):
        raise InputError(
            f"{path}: frames {first} to {last} are not in this motion, which has {len(motion)} frames; "
            f"give numbers from 0 to {len(motion) - 1}."
        )
    return first, last


def write_edited(path: Path, skeleton: Skeleton, motion: Motion, what: str = "") -> None:
    """Write a motion and print its path and length."""
    write_motion(path, skeleton, motion)
    say(f"written: {path}, {pluralise(len(motion), 'frame')} at {motion.rate:g} frames per second{what}")
