"""Motions and bodies that the verbs of `jaxcap edit` read and write."""

from pathlib import Path
from typing import Annotated

import numpy as np
import tyro

from ...body.body import Body
from ...body.pose import Motion
from ...body.skeleton import Skeleton
from ...errors import InputError
from ...io.npz import load_arrays
from ...io.registry import MOTION_WRITERS, SKELETON_READERS, read_motion, read_skeleton, write_motion
from ...io.text import read_text
from ..options import arg
from ..say import say
from ..sources import load_body

MotionFile = tyro.conf.Positional[Annotated[Path, arg(metavar="MOTION")]]
OutMotion = Annotated[Path, arg(aliases=("-o",), metavar="OUT")]
Frames = Annotated[tuple[int, int] | None, arg(metavar="FIRST LAST", help_behavior_hint="")]

#: skeletons whose joints are no further apart at rest are the same, metres
SAME = 1e-3
#: people are not so many times as large as each other, and every other unit is but feet for metres
OTHER_UNIT = 5.0
#: longest and shortest that somebody's joints reach, metres
REACH = (0.2, 5.0)


def check_out(path: Path, overwrite: bool) -> None:
    """That a motion can be written there. Raises `InputError`."""
    if path.suffix.lower() not in MOTION_WRITERS:
        raise InputError(
            f"{path}: motions are not written as '{path.suffix}' files; use {', '.join(MOTION_WRITERS)}."
        )
    check_new(path, overwrite)


def check_new(path: Path | None, overwrite: bool) -> None:
    """That a file is not there, or may be replaced. Raises `InputError`."""
    if path is None:
        return
    if path.exists() and not overwrite:
        raise InputError(f"{path}: this file is there already; give --overwrite to replace it.")
    if not path.absolute().parent.is_dir():
        raise InputError(f"{path}: its folder is not there; make it first.")


def read_edited(path: Path, unit: str | None) -> tuple[Skeleton, Motion]:
    """A motion with frames, of a person's size. Raises `InputError`."""
    skeleton, motion = read_motion(path, unit)
    if len(motion) == 0:
        raise InputError(f"{path}: there are no frames in this motion.")
    reach = extent(skeleton)
    if skeleton.num_joints > 1 and not REACH[0] < reach < REACH[1]:
        raise InputError(
            f"{path}: the joints of this motion reach over {reach:.4g} m at rest; say by --unit what its lengths are in."
        )
    return skeleton, motion


def extent(skeleton: Skeleton) -> float:
    """Longest side of the box around the joints at rest, metres."""
    return float(np.ptp(np.asarray(skeleton.centres, float), axis=0).max())


def load_target(spec: str) -> Body | Skeleton:
    """A body, or a skeleton from any file that has one. Raises `InputError`."""
    path = Path(spec)
    if path.suffix.lower() == ".npz" and path.is_file() and "vertices" not in load_arrays(path):
        return read_skeleton(path)
    if path.suffix.lower() in SKELETON_READERS and path.suffix.lower() != ".npz":
        if not path.is_file():
            raise InputError(f"{path}: there is no such file; check the path.")
        return read_skeleton(path)
    return load_body(spec)[0]


def skeleton_of(owner: Body | Skeleton) -> Skeleton:
    return owner if isinstance(owner, Skeleton) else owner.skeleton


def check_same(a: tuple[Path, Skeleton], b: tuple[Path, Skeleton]) -> None:
    """That two motions are of one skeleton. Raises `InputError`."""
    (_, one), (path, other) = a, b
    if one.names != other.names or one.parents != other.parents:
        strangers = sorted(set(one.names) ^ set(other.names))
        what = (
            f"'{strangers[0]}' is a joint of only one of them"
            if strangers
            else "their joints hang differently"
        )
        raise InputError(
            f"{path}: this motion is of another skeleton than {a[0]} ({what}); give it that one by `jaxcap edit retarget`."
        )
    offsets = [np.asarray(s.centres, float) - np.asarray(s.centres, float)[0] for s in (one, other)]
    apart = float(np.linalg.norm(offsets[0] - offsets[1], axis=1).max())
    if apart > SAME:
        raise InputError(
            f"{path}: the bones of this motion are up to {1000 * apart:.0f} mm off those of {a[0]}; give it that skeleton by "
            "`jaxcap edit retarget`."
        )


def frames_of(motion: Motion, frames: tuple[int, int] | None, path: Path) -> tuple[int, int]:
    """First and last frame, the whole motion where none are given. Raises `InputError`."""
    first, last = (0, len(motion) - 1) if frames is None else frames
    if not 0 <= first <= last < len(motion):
        raise InputError(
            f"{path}: frames {first} to {last} are not in this motion, which has {len(motion)}: 0 to {len(motion) - 1}."
        )
    return first, last


def save(path: Path, skeleton: Skeleton, motion: Motion, what: str = "") -> None:
    """Write a motion and say so."""
    write_motion(path, skeleton, motion)
    say(f"written: {path}, {len(motion)} frames at {motion.rate:g} a second{what}")


def table_of(path: Path) -> list[list[str]]:
    """The words of every line of a text file that is not empty; what follows `#` is a remark.

    **Raises:** `InputError` where the file cannot be read or a line has other than two or three words.
    """
    rows = []
    for number, line in enumerate(read_text(path).splitlines(), 1):
        words = line.split("#")[0].split()
        if not words:
            continue
        if len(words) not in (2, 3):
            raise InputError(
                f"{path}:{number}: this line has {len(words)} words; give one of the source and one of the target, and a "
                "weight where you like."
            )
        rows.append([str(number), *words])
    if not rows:
        raise InputError(f"{path}: there are no pairs in it; give one to a line.")
    return rows
