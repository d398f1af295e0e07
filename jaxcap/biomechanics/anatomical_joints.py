"""The joints of a person by their anatomical names, with the axes of the segments that they connect."""

import jax.numpy as jnp
import numpy as np

from ..arguments import checked
from ..body.matching.pairing import SIDES
from ..body.pose import Motion
from ..body.skeleton import Skeleton
from ..limits.rest_poses.anatomical_joint import AnatomicalJoint
from .anatomical_frames import find_anatomical_frames, find_upright
from .conventions import MIDLINE

#: joints of the limbs: type of the limb, place in it, proximal and distal segment
_JOINTS = {
    "hip": ("leg", 0, "pelvis", "femur"),
    "knee": ("leg", 1, "femur", "tibia"),
    "ankle": ("leg", 2, "tibia", "foot"),
    "shoulder": ("arm", 0, "thorax", "humerus"),
    "elbow": ("arm", 1, "humerus", "forearm"),
    "wrist": ("arm", 2, "forearm", "hand"),
}
#: anatomical names of these joints
JOINT_NAMES = tuple(f"{name}_{side[0]}" for side in SIDES for name in _JOINTS)


@checked
def find_anatomical_joints(skeleton: Skeleton, motion: Motion | None = None) -> dict[str, AnatomicalJoint]:
    """Find hips, knees, ankles, shoulders, elbows and wrists, by names such as `knee_r`.

    The shoulder is the joint of the upper arm; its proximal axes are those of the thorax, with the clavicle as at rest.
    Joints of segments with several rotating joints, such as a thigh with twist joints, are left out, except that a forearm
    may have a joint of pronation.

    **Arguments:** `motion` is for skeletons whose rest pose is not that of a person: see `find_anatomical_frames`.

    **Raises:** `InputError` where there is no person in the skeleton, or its left and right are not known.
    """
    frames = find_anatomical_frames(skeleton, motion)
    person = find_upright(skeleton, motion).person
    axes = dict(zip(frames.segments, np.asarray(frames.axes, float), strict=True))
    bones = dict(zip(frames.segments, frames.bones, strict=True))
    found = {}
    for side in SIDES:
        for name, (limb, place, _, _) in _JOINTS.items():
            joints = person.limb(side, limb)
            full = f"{name}_{side[0]}"
            proximal, distal = joint_segments(full)
            if not joints or proximal not in axes or distal not in axes:
                continue
            # a wrist that is named after a joint of pronation is the joint below it
            joint = bones[distal] if name == "wrist" else joints[place]
            if name != "elbow" and bones[distal] != joint and _turns_below(skeleton, joint, bones[distal]):
                continue
            found[full] = AnatomicalJoint(
                full, skeleton.names[joint], jnp.asarray(axes[proximal]), jnp.asarray(axes[distal])
            )
    return found


def joint_segments(joint: str) -> tuple[str, str]:
    """Return the names of the proximal and the distal segment of a joint, such as `femur_r` and `tibia_r` of `knee_r`."""
    name, side = joint.rsplit("_", 1)
    proximal, distal = (each if each in MIDLINE else f"{each}_{side}" for each in _JOINTS[name][2:])
    return proximal, distal


def _turns_below(skeleton: Skeleton, joint: int, bone: int) -> bool:
    """Test if a joint below `joint` rotates, on the path to `bone`."""
    while bone != joint and bone >= 0:
        if skeleton.kinds[bone] not in ("fixed", "translate"):
            return True
        bone = skeleton.parents[bone]
    return False
