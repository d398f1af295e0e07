"""The bodies and skeletons of the verbs of `jaxcap edit`, and their comparison."""

from pathlib import Path

import numpy as np

from ...body.body import Body
from ...body.skeleton import Skeleton, has_same_joints
from ...errors import InputError
from ...io.kinds import identify
from ...io.registry import BODY_SUFFIXES, SKELETON_READERS
from ...io.skinned.clip import suffix_of
from ..convert.conversion_kind import KNOWN_UNIT_SUFFIXES
from ..motions import load_skeleton
from ..sources import is_human_spec, load_body

#: maximum distance of the rest joints of equal skeletons, metres
MAX_JOINT_OFFSET = 1e-3
#: ratio of sizes that no two people have, but that a wrong unit causes, except feet for metres
MAX_SIZE_RATIO = 5.0


def load_target(spec: str, unit: str | None = None) -> Body | Skeleton:
    """Load a body, or a skeleton from any file that has one and no body. Raises `InputError`."""
    if unit and has_known_unit(spec):
        raise InputError(f"{spec}: its unit is known; omit --target-unit {unit}.")
    alone = suffix_of(spec) in SKELETON_READERS and suffix_of(spec) not in BODY_SUFFIXES
    if alone or identify(spec) in ("motion", "amass", "subject"):
        return load_skeleton(spec, unit)
    return load_body(spec, unit=unit or "m")[0]


def has_known_unit(spec: str | Path) -> bool:
    """Check if a body or a motion is in metres, or its file has a unit."""
    return is_human_spec(str(spec)) or suffix_of(spec) in KNOWN_UNIT_SUFFIXES


def skeleton_of(owner: Body | Skeleton) -> Skeleton:
    return owner if isinstance(owner, Skeleton) else owner.skeleton


def check_same_skeleton(a: tuple[Path, Skeleton], b: tuple[Path, Skeleton]) -> None:
    """Check that two motions have the same skeleton. Raises `InputError`."""
    (_, one), (path, other) = a, b
    if not has_same_joints(one, other):
        strangers = sorted(set(one.names) ^ set(other.names))
        what = (
            f"'{strangers[0]}' is a joint of only one of them"
            if strangers
            else "the parents of their joints differ"
        )
        raise InputError(
            f"{path}: the skeleton of this motion differs from that of {a[0]} ({what}); "
            "retarget the motion with `jaxcap edit retarget`."
        )
    # bones are compared, and not the rest position of the root
    offsets = [np.asarray(s.centres, float) - np.asarray(s.centres, float)[0] for s in (one, other)]
    difference = float(np.linalg.norm(offsets[0] - offsets[1], axis=1).max())
    if difference > MAX_JOINT_OFFSET:
        raise InputError(
            f"{path}: the bones of this motion differ from those of {a[0]} by up to {1000 * difference:.0f} mm; "
            "retarget the motion with `jaxcap edit retarget`."
        )
