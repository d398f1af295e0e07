"""`jaxcap edit keys`: keyframe reduction of a motion."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np

from ...body.pose import Motion
from ...body.skeleton import Skeleton
from ...edit.keys import Keyframes, find_keys
from ...errors import InputError
from ...io.archives.npz import save_arrays, skeleton_arrays
from ...io.table import write_json
from ..console.console import print_table, say
from ..console.options import Flag, OptionalFile, OptionalUnit, arg
from ..outputs import check_motion, check_new
from .files import MotionFile, load_checked_motion, write_edited

OptionalOut = Annotated[Path | None, arg(aliases=("-o",), metavar="OUT", help_behavior_hint="")]


@dataclass
class Keys:
    """Find few keys that reproduce a motion within a tolerance. Rotations are interpolated along the shortest arc."""

    motion: MotionFile
    out: OptionalOut = None
    """Output file for the motion that is interpolated from the keys, .bvh or .npz."""
    keys: OptionalFile = None
    """Output file for the keys, .json or .npz."""
    degrees: float = 1.0
    """Largest error of joint rotations, degrees."""
    millimetres: float = 5.0
    """Largest error of joint positions, millimetres."""
    per_joint: Flag = False
    """Find keys for each joint separately, instead of whole poses."""
    unit: OptionalUnit = None
    """Unit of the motion's lengths, if its file states none. Default: centimetres for BVH."""
    overwrite: Flag = False
    """Replace the results if they exist."""

    def run(self) -> None:
        if self.out is None and self.keys is None:
            raise InputError("There is nothing to write; give a motion with -o, or a file with --keys.")
        if self.out is not None:
            check_motion(self.out, self.overwrite)
        if self.keys is not None and self.keys.suffix.lower() not in (".json", ".npz"):
            raise InputError(
                f"{self.keys}: keys are written as .json or .npz; give a name that ends in one of these."
            )
        check_new(self.keys, self.overwrite)
        if self.out is not None and self.keys is not None and self.out.absolute() == self.keys.absolute():
            raise InputError(
                f"{self.out}: motion and keys cannot be the same file; give them different names."
            )
        for name, value in (("--degrees", self.degrees), ("--millimetres", self.millimetres)):
            if not 0 < value < np.inf:
                raise InputError(f"{name} is {value:g}; it must be above 0.")
        skeleton, motion = load_checked_motion(self.motion, self.unit)
        found = find_keys(skeleton, motion, self.degrees, self.millimetres / 1000, self.per_joint)
        print_summary(self.motion.name, skeleton, found, self.per_joint)
        if self.keys is not None:
            write_keys(self.keys, skeleton, motion, found)
            say(f"written: {self.keys}")
        if self.out is not None:
            write_edited(self.out, skeleton, found.motion)


def print_summary(name: str, skeleton: Skeleton, found: Keyframes, per_joint: bool) -> None:
    frames, joints = found.is_key.shape
    if per_joint:
        counts = found.is_key.sum(0)
        most = np.argsort(-counts, kind="stable")[:8]
        print_table(["joint", "keys"], [[skeleton.names[joint], str(counts[joint])] for joint in most])
        what = f"{found.count} keys of {joints} joints"
    else:
        what = f"{int(found.is_key[:, 0].sum())} poses"
    share = 100 * found.count / (frames * joints)
    say(
        f"{name}: {what} for {frames} frames ({share:.1f} % of the values); errors at most {found.degrees:.2f}° and "
        f"{1000 * found.metres:.1f} mm"
    )


def write_keys(path: Path, skeleton: Skeleton, motion: Motion, found: Keyframes) -> None:
    """Write the keys with their frames: as JSON by joint, as .npz all keys concatenated.

    Rotations are `wxyz` from rest, in the frame of the parent; translations in metres. Raises `InputError`.
    """
    rotations, translations = (
        np.asarray(x, float) for x in (motion.poses.rotations, motion.poses.translations)
    )
    if path.suffix.lower() == ".json":
        joints = {}
        for joint, name in enumerate(skeleton.names):
            frames = np.flatnonzero(found.is_key[:, joint])
            own: dict = {
                "frames": frames.tolist(),
                "rotations": np.round(rotations[frames, joint], 7).tolist(),
            }
            if np.any(translations[:, joint]):
                own["translations"] = np.round(translations[frames, joint], 7).tolist()
            joints[name] = own
        write_json(path, {"frames": len(found.is_key), "rate": motion.rate, "joints": joints})
        return
    frames, joints = np.nonzero(found.is_key)
    arrays = {
        "frames": frames,
        "joints": joints,
        "rotations": rotations[frames, joints],
        "translations": translations[frames, joints],
        "count": np.array(len(found.is_key)),
        "rate": np.array(motion.rate, float),
    }
    save_arrays(path, "jaxcap keys", {**skeleton_arrays(skeleton), **arrays})
