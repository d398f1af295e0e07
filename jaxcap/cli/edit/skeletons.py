"""Bodies and skeletons that the verbs of `jaxcap edit` are given, and whether two are alike."""

from pathlib import Path

import numpy as np

from ...body.body import Body
from ...body.skeleton import Skeleton, same_joints
from ...errors import InputError
from ...io.clip import suffix_of
from ...io.kinds import identify
from ...io.registry import BODY_SUFFIXES, SKELETON_READERS
from ..motions import load_skeleton
from ..sources import load_body

#: skeletons whose joints are no further apart at rest are the same, metres
SAME = 1e-3
#: people are not so many times as large as each other, and every other unit is but feet for metres
OTHER_UNIT = 5.0


def extent(skeleton: Skeleton) -> float:
    """Longest side of the box around the joints at rest, metres."""
    return float(np.ptp(np.asarray(skeleton.centres, float), axis=0).max())


def load_target(spec: str) -> Body | Skeleton:
    """A body, or a skeleton from any file that has one and no body. Raises `InputError`."""
    alone = suffix_of(spec) in SKELETON_READERS and suffix_of(spec) not in BODY_SUFFIXES
    if alone or identify(spec) in ("motion", "amass", "subject"):
        return load_skeleton(spec)
    return load_body(spec)[0]


def skeleton_of(owner: Body | Skeleton) -> Skeleton:
    return owner if isinstance(owner, Skeleton) else owner.skeleton


def check_same(a: tuple[Path, Skeleton], b: tuple[Path, Skeleton]) -> None:
    """That two motions are of one skeleton. Raises `InputError`."""
    (_, one), (path, other) = a, b
    if not same_joints(one, other):
        strangers = sorted(set(one.names) ^ set(other.names))
        what = (
            f"'{strangers[0]}' is a joint of only one of them"
            if strangers
            else "their joints hang differently"
        )
        raise InputError(
            f"{path}: this motion is of another skeleton than {a[0]} ({what}); give it that one by `jaxcap edit retarget`."
        )
    # bones count here, and not where the root stands at rest
    offsets = [np.asarray(s.centres, float) - np.asarray(s.centres, float)[0] for s in (one, other)]
    apart = float(np.linalg.norm(offsets[0] - offsets[1], axis=1).max())
    if apart > SAME:
        raise InputError(
            f"{path}: the bones of this motion are up to {1000 * apart:.0f} mm off those of {a[0]}; give it that skeleton by "
            "`jaxcap edit retarget`."
        )
