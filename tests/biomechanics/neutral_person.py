"""A person of joint centres in the anatomical position: upright, arms along the trunk, thumbs to the sides."""

import jax.numpy as jnp
import numpy as np
from scipy.spatial.transform import Rotation

import jaxcap as jc

#: joint -> parent, centre in metres (left side), name in BVH files, name in SMPL-X; the person looks along +z
TRUNK = {
    "pelvis": (None, (0, 1.0, 0), "Hips", "pelvis"),
    "spine": ("pelvis", (0, 1.1, 0), "Spine", "spine1"),
    "chest": ("spine", (0, 1.25, 0), "Chest", "spine3"),
    "neck": ("chest", (0, 1.5, 0), "Neck", "neck"),
    "head": ("neck", (0, 1.6, 0), "Head", "head"),
}
SIDE = {
    "thigh": ("pelvis", (0.1, 0.95, 0), "UpLeg", "hip"),
    "shin": ("thigh", (0.1, 0.5, 0), "Leg", "knee"),
    "foot": ("shin", (0.1, 0.08, 0), "Foot", "ankle"),
    "toes": ("foot", (0.1, 0.02, 0.14), "ToeBase", "foot"),
    "clavicle": ("chest", (0.03, 1.4, 0), "Shoulder", "collar"),
    "upper_arm": ("clavicle", (0.18, 1.4, 0), "Arm", "shoulder"),
    "forearm": ("upper_arm", (0.18, 1.1, 0), "ForeArm", "elbow"),
    "hand": ("forearm", (0.18, 0.85, 0), "Hand", "wrist"),
    "finger": ("hand", (0.18, 0.76, 0), "HandMiddle1", "middle1"),
    "thumb": ("hand", (0.21, 0.82, 0), "HandThumb1", "thumb1"),
}
#: axes X forward, Y up, Z to the right of this person, as columns in the world
ISB = np.array([[0, 0, -1.0], [0, 1, 0], [1, 0, 0]])


def person(smpl=False, leave_out=(), kinds=None, axes=None):
    """The skeleton, and the index of each joint by its part, such as `shin_r`."""
    names, parents, centres, index = [], [], [], {}

    def add(key, parent, centre, name):
        index[key] = len(names)
        names.append(name)
        parents.append(-1 if parent is None else index[parent])
        centres.append(centre)

    for part, (parent, centre, bvh, model) in TRUNK.items():
        if part not in leave_out:
            add(part, parent, centre, model if smpl else bvh)
    for side, word, sign in (("l", "left", 1), ("r", "right", -1)):
        for part, (parent, (x, y, z), bvh, model) in SIDE.items():
            if part in leave_out:
                continue
            above = parent if parent in TRUNK else f"{parent}_{side}"
            name = f"{word}_{model}" if smpl else f"{word.capitalize()}{bvh}"
            add(f"{part}_{side}", above, (sign * x, y, z), name)
    whole = ["free"] + ["ball"] * (len(names) - 1)
    for key, kind in (kinds or {}).items():
        whole[index[key]] = kind
    two = np.tile(np.eye(3)[:2], (len(names), 1, 1))
    for key, axis in (axes or {}).items():
        two[index[key], 0] = axis
    return jc.make_skeleton(names, parents, whole, np.array(centres, float), axes=two), index


def pose(skeleton, rotations):
    """A pose of SciPy's rotations from rest, in the world at rest, by the index of their joints."""
    still = jc.rest_pose(skeleton)
    quaternions = np.array(still.rotations)
    for joint, rotation in rotations.items():
        quaternions[joint] = rotation.as_quat()[[3, 0, 1, 2]]
    return jc.Pose(still.translations, jnp.asarray(quaternions), still.scale)


def in_world(rotation):
    """The rotation in the world of one whose components are along X forward, Y up, Z to the right."""
    return Rotation.from_matrix(ISB @ rotation.as_matrix() @ ISB.T)


def mirrored(rotation):
    """The mirror image of a rotation with the components of `in_world`."""
    return Rotation.from_rotvec(rotation.as_rotvec() * [-1, -1, 1])
