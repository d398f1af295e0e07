"""The joints of SMPL's family in motions in AMASS's format, and the skeleton that a motion has or is given."""

import warnings
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from ....body.skeleton import Skeleton, has_same_joints, rest_distance
from ....errors import InputError
from ...archives.npz import skeleton_of

#: begin of the names of the arrays of a skeleton
SKELETON_PREFIX = "skeleton."
#: largest distance of joints at rest for the same body, metres
MAX_REST_DISTANCE = 0.01
_TRUNK_PARENTS = (-1, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 9, 9, 12, 13, 14, 16, 17, 18, 19)


def _finger_parents(wrist: int, first: int) -> tuple[int, ...]:
    """Return the parents of five fingers of three joints."""
    return tuple(
        parent for finger in range(5) for parent in (wrist, first + 3 * finger, first + 3 * finger + 1)
    )


#: parents of the joints of SMPL's family, by their number: SMPL without hands, SMPL, SMPL-H, SMPL-X
SMPL_PARENTS = {
    22: _TRUNK_PARENTS,
    24: (*_TRUNK_PARENTS, 20, 21),
    52: (*_TRUNK_PARENTS, *_finger_parents(20, 22), *_finger_parents(21, 37)),
    55: (*_TRUNK_PARENTS, 15, 15, 15, *_finger_parents(20, 25), *_finger_parents(21, 40)),
}


#: the parts of the poses of SMPL-X, as AMASS names them: first joint, and joint after the last one
SMPL_X_PARTS = {
    "root_orient": (0, 1),
    "pose_body": (1, 22),
    "pose_jaw": (22, 23),
    "pose_eye": (23, 25),
    "pose_hand": (25, 55),
}

#: the model that has so many joints
_FAMILIES = {22: "SMPL without hands", 24: "SMPL", 52: "SMPL-H", 55: "SMPL-X"}
#: the models that have the shapes of SMPL
SMPL_SHAPES = ("SMPL", "SMPL-H")
#: joints of the models without hands and face
NUM_TRUNK = 22


def is_trunk_shared(joints: int, others: int) -> bool:
    """Test if two models of so many joints differ in the joints of hands only: SMPL and SMPL-H also have the same shapes, and a
    motion without hands has those of its body."""
    return joints != others and (joints == NUM_TRUNK or {joints, others} == {24, 52})


def describe_joints(joints: int) -> str:
    """Describe the joints of the poses of a file."""
    return f"poses of {joints} joint{'' if joints == 1 else 's'}{f' ({_FAMILIES[joints]})' if joints in _FAMILIES else ''}"


def find_skeleton(
    path: str | Path, arrays: Mapping[str, np.ndarray], joints: int, skeleton: Skeleton | None
) -> Skeleton:
    """Return the given skeleton after a check of its joints, or the file's own. Raises `InputError`."""
    noted = {
        name.removeprefix(SKELETON_PREFIX): values
        for name, values in arrays.items()
        if name.startswith(SKELETON_PREFIX)
    }
    if noted:
        own = skeleton_of(noted, path)
        if own.num_joints != joints:
            raise InputError(
                f"{path}: the poses have {joints} joints, and the skeleton of the file has {own.num_joints}; write it again."
            )
        if skeleton is None:
            return own
        if not has_same_joints(own, skeleton):
            raise InputError(
                f"{path}: this motion has the joints {', '.join(own.names)}; expected {', '.join(skeleton.names)} as in the body; "
                "retarget it."
            )
        distance = rest_distance(own, skeleton)
        if distance > MAX_REST_DISTANCE:
            raise InputError(
                f"{path}: this motion belongs to another body: its joints at rest differ by up to {1000 * distance:.0f} mm "
                "from those of this body; retarget it."
            )
        return skeleton
    what = _FAMILIES.get(joints)
    poses = describe_joints(joints)
    if skeleton is None:
        raise InputError(
            f"{path}: the file has {poses} but no skeleton; give a body with these joints, or add its skeleton by `jaxcap convert {path} motion.npz --body "
            "BODY`."
        )
    if skeleton.parents in SMPL_PARENTS.values() and is_trunk_shared(joints, skeleton.num_joints):
        if joints > NUM_TRUNK:
            warnings.warn(
                f"{path}: the file has {poses} and the body has {skeleton.num_joints}; the {NUM_TRUNK} joints without hands are read, "
                "and hands are at rest.",
                stacklevel=5,
            )
        return skeleton
    if skeleton.num_joints != joints:
        raise InputError(
            f"{path}: the file has {poses} and the body has {skeleton.num_joints} joints; give a body with the same joints, and convert "
            "the motion to the other body with --to in `jaxcap convert` (`edit.convert_motion` in Python)."
            if {joints, skeleton.num_joints} <= SMPL_PARENTS.keys()
            else f"{path}: the file has {poses} and the body has {skeleton.num_joints} joints; give a body with the same joints."
        )
    if joints in SMPL_PARENTS and skeleton.parents != SMPL_PARENTS[joints]:
        wrong = next(j for j in range(joints) if skeleton.parents[j] != SMPL_PARENTS[joints][j])
        raise InputError(
            f"{path}: the file has {poses}, but joint {wrong} of the body, '{skeleton.names[wrong]}', has another parent "
            f"than in {what}; give a body with its joints in that order."
        )
    return skeleton
