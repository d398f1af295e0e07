"""Landmarks of the embedded human's surface: where laboratories place their markers.

Each landmark is at an offset from a joint of the man of 25 at rest, and belongs to the skin nearest to that
position. It is attached to the surface's triangles, so every build has it. A landmark near a joint belongs to the
bone that it is palpated on: the epicondyles of the knee to the thigh, the malleoli to the shank. Levels of
vertebrae are spread between the prominent one (C7) and the sacrum.
"""

import functools
from typing import NamedTuple

import numpy as np

from ...body.people.human import human
from ...body.skin.interpolate import clamp_barycentric
from ...geometry.attachment import Attachment, attach_points

#: bone, joint that the offset starts at, metres to the left, up and to the front, and standard deviation of a
#: marker's placement, metres: 10 mm where a bone is palpated, more where there is none
MIDLINE_LANDMARKS = {
    "head_top": ("Head", "Head", (0.000, 0.147, 0.003), 0.010),
    "head_front": ("Head", "Head", (0.000, 0.072, 0.108), 0.015),
    "head_back": ("Head", "Head", (0.000, 0.062, -0.092), 0.015),
    "nose_bridge": ("Head", "Head", (0.000, 0.035, 0.107), 0.010),
    "nose": ("Head", "Head", (0.000, -0.003, 0.116), 0.010),
    "occiput": ("Head", "Head", (0.000, 0.017, -0.083), 0.010),
    "chin": ("Head", "Head", (0.000, -0.068, 0.105), 0.010),
    "c7": ("Spine1", "Spine1", (0.000, 0.182, 0.013), 0.010),
    "t1": ("Spine1", "Spine1", (0.000, 0.162, 0.008), 0.015),
    "t2": ("Spine1", "Spine1", (0.000, 0.142, 0.003), 0.015),
    "t3": ("Spine1", "Spine1", (0.000, 0.122, -0.003), 0.015),
    "t4": ("Spine1", "Spine1", (0.000, 0.102, -0.008), 0.015),
    "t5": ("Spine1", "Spine1", (0.000, 0.082, -0.012), 0.015),
    "t6": ("Spine1", "Spine1", (0.000, 0.057, -0.016), 0.015),
    "t7": ("Spine1", "Spine1", (0.000, 0.035, -0.018), 0.015),
    "t8": ("Spine1", "Spine1", (0.000, 0.012, -0.019), 0.015),
    "t9": ("Spine", "Spine", (0.000, 0.122, -0.042), 0.015),
    "t10": ("Spine", "Spine", (0.000, 0.097, -0.041), 0.015),
    "t11": ("Spine", "Spine", (0.000, 0.075, -0.040), 0.015),
    "t12": ("Spine", "Spine", (0.000, 0.053, -0.039), 0.015),
    "l1": ("Spine", "Spine", (0.000, 0.022, -0.038), 0.015),
    "l2": ("LowerBack", "LowerBack", (0.000, 0.119, -0.031), 0.015),
    "l3": ("LowerBack", "LowerBack", (0.000, 0.084, -0.023), 0.015),
    "l4": ("LowerBack", "LowerBack", (0.000, 0.051, -0.022), 0.015),
    "l5": ("Hips", "Hips", (0.000, 0.107, -0.061), 0.015),
    "sacrum": ("Hips", "Hips", (0.000, 0.079, -0.070), 0.015),
    "jugular_notch": ("Spine1", "Spine1", (0.000, 0.125, 0.134), 0.010),
    "sternum": ("Spine1", "Spine1", (0.000, 0.072, 0.162), 0.015),
    "xiphoid": ("Spine1", "Spine1", (0.000, -0.048, 0.188), 0.010),
    "navel": ("LowerBack", "LowerBack", (0.000, 0.061, 0.159), 0.020),
    "pubis": ("Hips", "Hips", (0.000, -0.021, 0.122), 0.020),
}  # fmt: skip

#: the same of the left side; the right side is its mirror image
LATERAL_LANDMARKS = {
    "head_front_lateral": ("Head", "Head", (0.057, 0.067, 0.079), 0.015),
    "head_back_lateral": ("Head", "Head", (0.051, 0.067, -0.065), 0.015),
    "head_side": ("Head", "Head", (0.071, 0.072, 0.003), 0.015),
    "temple": ("Head", "Head", (0.064, 0.047, 0.048), 0.015),
    "ear": ("Head", "Head", (0.071, 0.012, 0.018), 0.010),
    "sternoclavicular": ("Spine1", "LeftShoulder", (0.002, 0.012, 0.051), 0.010),
    "clavicle": ("LeftShoulder", "LeftShoulder", (0.067, 0.017, 0.031), 0.015),
    "acromioclavicular": ("LeftShoulder", "LeftArm", (-0.030, 0.067, 0.003), 0.010),
    "acromion": ("LeftShoulder", "LeftArm", (-0.001, 0.053, -0.010), 0.010),
    "acromial_angle": ("LeftShoulder", "LeftArm", (0.003, 0.036, -0.041), 0.015),
    "coracoid": ("LeftShoulder", "LeftArm", (-0.045, 0.015, 0.061), 0.015),
    "scapula_spine_root": ("LeftShoulder", "Spine1", (0.075, 0.112, -0.027), 0.015),
    "scapula_inferior_angle": ("LeftShoulder", "Spine1", (0.095, 0.022, -0.038), 0.015),
    "scapula": ("Spine1", "Spine1", (0.090, 0.072, -0.038), 0.020),
    "shoulder_back": ("LeftShoulder", "LeftArm", (-0.010, 0.010, -0.066), 0.020),
    "shoulder_front": ("LeftShoulder", "LeftArm", (-0.010, 0.010, 0.060), 0.020),
    "back_lateral": ("Spine1", "Spine1", (0.100, -0.008, -0.030), 0.020),
    "chest_lateral": ("Spine1", "Spine1", (0.100, 0.022, 0.188), 0.020),
    "rib_lateral": ("Spine", "Spine", (0.148, 0.060, 0.024), 0.020),
    "deltoid": ("LeftArm", "LeftArm", (0.083, -0.029, -0.005), 0.020),
    "upper_arm_lateral": ("LeftArm", "LeftArm", (0.122, -0.079, -0.005), 0.030),
    "upper_arm_front": ("LeftArm", "LeftArm", (0.095, -0.103, 0.047), 0.030),
    "upper_arm_back": ("LeftArm", "LeftArm", (0.071, -0.089, -0.053), 0.030),
    "elbow_lateral": ("LeftArm", "LeftForeArm", (0.023, 0.020, -0.003), 0.010),
    "elbow_medial": ("LeftArm", "LeftForeArm", (-0.029, -0.026, 0.004), 0.010),
    "olecranon": ("LeftForeArm", "LeftForeArm", (0.006, -0.010, -0.027), 0.010),
    "forearm_lateral": ("LeftForeArm", "LeftForeArm", (0.083, -0.032, 0.103), 0.030),
    "forearm_radial": ("LeftForeArm", "LeftForeArm", (0.046, -0.048, 0.118), 0.030),
    "forearm_ulnar": ("LeftForeArm", "LeftForeArm", (0.086, -0.077, 0.071), 0.030),
    "wrist_radial": ("LeftForeArm", "LeftHand", (-0.019, 0.014, 0.012), 0.010),
    "wrist_ulnar": ("LeftForeArm", "LeftHand", (0.011, -0.007, -0.024), 0.010),
    "wrist_dorsal": ("LeftForeArm", "LeftHand", (0.010, 0.017, -0.002), 0.015),
    "hand_dorsal": ("LeftHand", "LeftHand", (0.047, -0.041, 0.060), 0.020),
    "hand_2nd_knuckle": ("LeftHand", "LeftHand", (0.036, -0.039, 0.102), 0.015),
    "hand_3rd_knuckle": ("LeftHand", "LeftHand", (0.055, -0.064, 0.097), 0.015),
    "hand_5th_knuckle": ("LeftHand", "LeftHand", (0.068, -0.095, 0.061), 0.015),
    "thumb": ("LThumb", "LThumb", (-0.015, 0.000, 0.029), 0.020),
    "index_finger_tip": ("LeftHandFinger1", "LeftHandFinger1", (0.007, -0.046, 0.050), 0.020),
    "middle_finger_tip": ("LeftHandFinger1", "LeftHandFinger1", (0.033, -0.077, 0.033), 0.020),
    "little_finger_tip": ("LeftHandFinger1", "LeftHandFinger1", (0.042, -0.088, -0.036), 0.020),
    "asis": ("Hips", "Hips", (0.123, 0.074, 0.090), 0.010),
    "psis": ("Hips", "Hips", (0.045, 0.091, -0.069), 0.010),
    "iliac_crest": ("Hips", "Hips", (0.137, 0.124, 0.013), 0.015),
    "hip_lateral": ("Hips", "Hips", (0.146, 0.069, 0.013), 0.020),
    "waist_back_lateral": ("Hips", "Hips", (0.090, 0.099, -0.052), 0.020),
    "trochanter": ("LeftUpLeg", "LeftUpLeg", (0.040, -0.010, -0.016), 0.015),
    "thigh_lateral_high": ("LeftUpLeg", "LeftUpLeg", (0.075, -0.122, 0.010), 0.030),
    "thigh_lateral": ("LeftUpLeg", "LeftUpLeg", (0.087, -0.206, 0.017), 0.030),
    "thigh_lateral_low": ("LeftUpLeg", "LeftUpLeg", (0.089, -0.301, 0.025), 0.030),
    "thigh_front_high": ("LeftUpLeg", "LeftUpLeg", (0.013, -0.119, 0.122), 0.030),
    "thigh_front": ("LeftUpLeg", "LeftUpLeg", (0.021, -0.204, 0.125), 0.030),
    "thigh_front_low": ("LeftUpLeg", "LeftUpLeg", (0.032, -0.313, 0.108), 0.030),
    "thigh_back": ("LeftUpLeg", "LeftUpLeg", (0.024, -0.234, -0.042), 0.030),
    "thigh_medial": ("LeftUpLeg", "LeftUpLeg", (-0.043, -0.306, 0.024), 0.030),
    "knee_lateral": ("LeftUpLeg", "LeftLeg", (0.048, 0.005, 0.000), 0.010),
    "knee_medial": ("LeftUpLeg", "LeftLeg", (-0.050, -0.005, 0.000), 0.010),
    "patella": ("LeftUpLeg", "LeftLeg", (0.000, 0.010, 0.054), 0.010),
    "tibial_tuberosity": ("LeftLeg", "LeftLeg", (0.004, -0.065, 0.031), 0.010),
    "fibula_head": ("LeftLeg", "LeftLeg", (0.064, -0.034, -0.031), 0.010),
    "tibia_condyle_medial": ("LeftLeg", "LeftLeg", (-0.037, -0.034, 0.000), 0.015),
    "shank_lateral_high": ("LeftLeg", "LeftLeg", (0.071, -0.125, -0.004), 0.030),
    "shank_lateral": ("LeftLeg", "LeftLeg", (0.074, -0.212, -0.006), 0.030),
    "shank_lateral_low": ("LeftLeg", "LeftLeg", (0.072, -0.309, -0.009), 0.030),
    "shank_front_high": ("LeftLeg", "LeftLeg", (0.009, -0.130, 0.025), 0.030),
    "shank_front": ("LeftLeg", "LeftLeg", (0.018, -0.217, 0.019), 0.030),
    "shank_front_low": ("LeftLeg", "LeftLeg", (0.029, -0.325, 0.015), 0.030),
    "shank_medial": ("LeftLeg", "LeftLeg", (-0.016, -0.221, -0.006), 0.030),
    "calf": ("LeftLeg", "LeftLeg", (0.015, -0.152, -0.088), 0.030),
    "ankle_lateral": ("LeftLeg", "LeftFoot", (0.035, -0.008, -0.013), 0.010),
    "ankle_medial": ("LeftLeg", "LeftFoot", (-0.026, 0.004, 0.003), 0.010),
    "heel": ("LeftFoot", "LeftFoot", (0.000, -0.032, -0.062), 0.010),
    "heel_high": ("LeftFoot", "LeftFoot", (0.000, -0.008, -0.057), 0.015),
    "heel_lateral": ("LeftFoot", "LeftFoot", (0.028, -0.045, -0.030), 0.015),
    "heel_medial": ("LeftFoot", "LeftFoot", (-0.026, -0.045, -0.030), 0.015),
    "navicular": ("LeftFoot", "LeftFoot", (-0.027, -0.015, 0.045), 0.010),
    "foot_1st_base": ("LeftFoot", "LeftFoot", (-0.010, 0.000, 0.070), 0.015),
    "foot_2nd_base": ("LeftFoot", "LeftFoot", (0.005, -0.006, 0.080), 0.015),
    "foot_5th_base": ("LeftFoot", "LeftFoot", (0.045, -0.045, 0.055), 0.010),
    "foot_1st_head": ("LeftFoot", "LeftToeBase", (-0.051, 0.007, -0.012), 0.010),
    "foot_2nd_head": ("LeftFoot", "LeftToeBase", (-0.012, 0.010, -0.012), 0.010),
    "foot_3rd_head": ("LeftFoot", "LeftToeBase", (0.005, 0.008, -0.018), 0.015),
    "foot_5th_head": ("LeftFoot", "LeftToeBase", (0.037, -0.004, -0.040), 0.010),
    "toe_tip": ("LeftToeBase", "LeftToeBase", (-0.012, -0.010, 0.055), 0.015),
    "big_toe": ("LeftToeBase", "LeftToeBase", (-0.018, -0.009, 0.054), 0.015),
}  # fmt: skip


#: points at the centres of joints of the left side: the bone that carries them, and the joint. Networks that see joints in images are a few
#: centimetres off (Needham and others 2021)
JOINT_LANDMARKS = {
    "shoulder_centre": ("LeftShoulder", "LeftArm"), "elbow_centre": ("LeftArm", "LeftForeArm"), "wrist_centre": ("LeftForeArm", "LeftHand"),
    "hip_centre": ("Hips", "LeftUpLeg"), "knee_centre": ("LeftUpLeg", "LeftLeg"), "ankle_centre": ("LeftLeg", "LeftFoot"),
}  # fmt: skip
JOINT_DEVIATION = 0.03


class Landmark(NamedTuple):
    """A position on the skin of the man of 25 at rest, or at the centre of a joint."""

    #: joint whose bone carries the landmark, and joint that the offset starts at
    bone: str
    joint: str
    #: metres to the person's left, up and to the front
    offset: tuple[float, float, float]
    #: standard deviation of a marker's placement, metres
    deviation: float


def mirror_name(name: str) -> str:
    """Exchange left and right in the name of a joint: `LeftArm`, `LThumb`."""
    for left, right in (("Left", "Right"), ("LThumb", "RThumb"), ("LHip", "RHip")):
        if name.startswith(left):
            return right + name.removeprefix(left)
    return name


def mirror_landmark(name: str) -> str:
    """Name the same landmark of the other side; one in the middle is its own mirror image."""
    side, _, rest = name.partition(" ")
    return f"{dict(left='right', right='left')[side]} {rest}" if side in ("left", "right") else name


@functools.cache
def landmarks() -> dict[str, Landmark]:
    """Build the table of all landmarks by name, such as `c7`, `left knee_lateral` and `right asis`."""
    table = {name: Landmark(*row) for name, row in MIDLINE_LANDMARKS.items()}
    for name, (bone, joint, (x, y, z), deviation) in LATERAL_LANDMARKS.items():
        table[f"left {name}"] = Landmark(bone, joint, (x, y, z), deviation)
        table[f"right {name}"] = Landmark(mirror_name(bone), mirror_name(joint), (-x, y, z), deviation)
    return table


@functools.cache
def joint_landmarks() -> dict[str, Landmark]:
    """Build the table of points at the centres of joints by name, such as `left knee_centre`."""
    table = {}
    for name, (bone, joint) in JOINT_LANDMARKS.items():
        table[f"left {name}"] = Landmark(bone, joint, (0.0, 0.0, 0.0), JOINT_DEVIATION)
        table[f"right {name}"] = Landmark(
            mirror_name(bone), mirror_name(joint), (0.0, 0.0, 0.0), JOINT_DEVIATION
        )
    return table


@functools.cache
def landmark_attachment(resolution: str = "full") -> tuple[tuple[str, ...], Attachment]:
    """Attach all landmarks to the skin of the human of a named resolution, for any build.

    Returns the names and their attachment, at height 0.
    """
    body, table = human(resolution=resolution), landmarks()  # pyright: ignore[reportArgumentType]
    centres = dict(zip(body.skeleton.names, np.asarray(body.skeleton.centres, float), strict=True))
    near = np.array([centres[mark.joint] + mark.offset for mark in table.values()])
    hold = attach_points(near, np.asarray(body.vertices, float), np.asarray(body.faces))
    on_skin = Attachment(hold.corners, clamp_barycentric(hold.barycentric), np.zeros_like(hold.heights))
    return tuple(table), on_skin
