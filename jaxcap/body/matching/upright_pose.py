"""Find a pose in which a person stands upright, for the comparison of rest poses.

Rest poses of files need not be poses of a person. If joints have their own frames, as in files from Unreal,
Maya or Bandai Namco, all bones of a BVH file lie along one axis until the first frame. The frame of the
motion in which the person stands straightest then replaces the rest pose.
"""

from collections.abc import Collection
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from ...errors import user_message
from ...geometry.axes import nearest_axis
from ...geometry.sampling import even_indices
from ..pose import Motion, Pose, take_poses
from ..skeleton import Skeleton
from .person_joints import PersonJoints, snap_to_axis, trunk_direction
from .sides import UnknownSides, resolve_sides

#: largest cosine between trunk and legs of a standing person, and least length of a leg relative to its bones
MAX_TRUNK_LEG_COSINE, MIN_LEG_EXTENSION = -0.5, 0.7
#: largest number of frames that are examined, and largest angle from a coordinate axis at which a person is
#: taken to stand along it
MAX_FRAMES, MAX_AXIS_ANGLE = 300, np.radians(25.0)


class UprightPose(NamedTuple):
    """A pose in which a person stands upright; J joints."""

    person: PersonJoints
    #: (J, 3) positions, metres
    positions: Float[np.ndarray, "J 3"]
    #: (J, 4) world rotations from rest
    rotations: Float[np.ndarray, "J 4"]
    #: frame of the motion; None if it is the rest pose
    frame: int | None
    #: columns left, up and front of the person; None if they cannot be determined
    axes: Float[np.ndarray, "3 3"] | None
    #: coordinate axis from the feet to the hips; None without legs
    up: Float[np.ndarray, "3"] | None


def find_upright_pose(
    skeleton: Skeleton,
    person: PersonJoints,
    motion: Motion | None,
    which: str,
    known_sides: Collection[str] = (),
) -> UprightPose:
    """Find an upright pose of a person: rest, or else the straightest frame of a motion.

    The sides of limbs without sides in their names are determined too.

    **Arguments:** `which` is "source" or "target", for messages. `known_sides` are types of limbs whose sides a name
    table gives.

    **Raises:** `ValueError` if the person stands neither at rest nor in any frame; its subclass
    `UnknownSides` if left and right cannot be determined.
    """
    rest = np.asarray(skeleton.centres, float)
    still = np.tile([1.0, 0, 0, 0], (len(rest), 1))
    if upright_score(person, rest) > 0:
        return _make_upright_pose(person, rest, still, None, which, known_sides)
    if motion is None or len(motion) == 0:
        raise ValueError(
            f"The rest pose of the {which} is not upright, so it cannot be compared with another one; "
            + (
                "give its motion, with an upright frame."
                if which == "source"
                else "give a skeleton with an upright rest pose."
            )
        )
    frames = even_indices(len(motion), MAX_FRAMES)
    positions, turns = joint_transforms(skeleton, take_poses(motion.poses, frames))
    scores = np.array([upright_score(person, frame) for frame in positions])
    best = int(np.argmax(scores))
    if scores[best] <= 0:
        raise ValueError(
            f"The {which} is upright, legs below the trunk, neither at rest nor in any frame, so its rest pose cannot "
            "be compared with another one; give a motion with an upright frame."
        )
    return _make_upright_pose(person, positions[best], turns[best], int(frames[best]), which, known_sides)


def joint_transforms(
    skeleton: Skeleton, poses: Pose
) -> tuple[Float[np.ndarray, "F J 3"], Float[np.ndarray, "F J 4"]]:
    """Compute world positions and rotations of all joints in each pose of a stack, metres and quaternions.

    It uses NumPy, because a skeleton is used once and compiling for it would take longer.
    """
    centres = np.asarray(skeleton.centres, float)
    turns = np.array(poses.rotations, float)
    steps = np.asarray(poses.translations, float)
    scale = np.asarray(poses.scale, float)[:, None]
    positions = np.zeros((len(turns), len(centres), 3))
    for joint, parent in enumerate(skeleton.parents):
        if parent < 0:
            positions[:, joint] = scale * (centres[joint] + steps[:, joint])
            continue
        above = Rotation.from_quat(turns[:, parent][:, [1, 2, 3, 0]])
        positions[:, joint] = positions[:, parent] + scale * above.apply(
            centres[joint] - centres[parent] + steps[:, joint]
        )
        whole = above * Rotation.from_quat(turns[:, joint][:, [1, 2, 3, 0]])
        turns[:, joint] = whole.as_quat()[:, [3, 0, 1, 2]]
    return positions, turns


def upright_score(person: PersonJoints, positions: Float[np.ndarray, "J 3"]) -> float:
    """Rate how straight a person stands.

    The score is above zero if the legs point away from the trunk, and two for a straight line. It is one if
    the skeleton has no legs or no trunk, as any pose is then possible.
    """
    trunk = trunk_direction(person, positions)
    legs = [leg for side in ("left", "right") if (leg := person.limb(side, "leg"))]
    if trunk is None or not legs:
        return 1.0
    score = []
    for thigh, shin, foot in legs:
        leg = positions[foot] - positions[thigh]
        bones = np.linalg.norm(positions[shin] - positions[thigh]) + np.linalg.norm(
            positions[foot] - positions[shin]
        )
        length = max(float(np.linalg.norm(leg)), 1e-12)
        cosine = float(leg @ trunk) / length
        score.append(
            -1.0
            if cosine > MAX_TRUNK_LEG_COSINE or length < MIN_LEG_EXTENSION * bones
            else length / max(bones, 1e-12) - cosine
        )
    return float(min(score)) if min(score) < 0 else float(np.mean(score))


def _make_upright_pose(
    person: PersonJoints,
    positions: np.ndarray,
    rotations: np.ndarray,
    frame: int | None,
    which: str,
    known_sides: Collection[str],
) -> UprightPose:
    trunk = trunk_direction(person, positions)
    up = None
    legs = [leg for side in ("left", "right") if (leg := person.limb(side, "leg"))]
    if legs:
        up = nearest_axis(np.mean([positions[leg[0]] - positions[leg[2]] for leg in legs], axis=0))
    if trunk is None:
        return UprightPose(person, positions, rotations, frame, None, up)
    along = snap_to_axis(trunk, MAX_AXIS_ANGLE)
    try:
        person = resolve_sides(person, positions, along, known_sides)
    except UnknownSides as error:
        raise UnknownSides(f"In the {which}: {user_message(error)}", error.swapped) from None
    left = np.zeros(3)
    for part in ("thigh", "upper_arm"):
        if ("left", part) in person.parts and ("right", part) in person.parts:
            left += positions[person.parts["left", part]] - positions[person.parts["right", part]]
    left -= (left @ along) * along
    if np.linalg.norm(left) < 1e-6:
        return UprightPose(person, positions, rotations, frame, None, up)
    left = snap_to_axis(left / np.linalg.norm(left), MAX_AXIS_ANGLE) if frame is None else left
    left = left - (left @ along) * along
    left = left / np.linalg.norm(left)
    return UprightPose(
        person, positions, rotations, frame, np.stack([left, along, np.cross(left, along)], 1), up
    )
