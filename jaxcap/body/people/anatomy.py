"""Regions of a human body by the names of its joints, and standard deviations of its joints from rest."""

import numpy as np
from jaxtyping import Float

from ..skeleton import Skeleton

#: joints of the embedded human in each region of the body, without their side
BODY_REGIONS: dict[str, tuple[str, ...]] = {
    "trunk": ("Hips", "LowerBack", "Spine", "Spine1"),
    "head": ("Neck", "Neck1", "Head"),
    "arm": ("Shoulder", "Arm", "ForeArm", "Hand", "FingerBase", "HandFinger1", "Thumb"),
    "leg": ("HipJoint", "UpLeg", "Leg", "Foot", "ToeBase"),
}
#: radians of twist about the bone, of flexion, and sideways, by the joint's name without its
#: side; about a third of the ranges of motion of adults (Kapandji, The Physiology of the Joints)
DEVIATIONS: dict[str, tuple[float, float, float]] = {
    "LowerBack": (0.3, 0.4, 0.3),
    "Spine": (0.3, 0.4, 0.3),
    "Spine1": (0.2, 0.3, 0.2),
    "Neck": (0.3, 0.3, 0.3),
    "Neck1": (0.3, 0.3, 0.3),
    "Head": (0.3, 0.3, 0.3),
    "Shoulder": (0.15, 0.25, 0.25),
    "Arm": (0.8, 1.0, 1.0),
    "ForeArm": (0.4, 1.2, 0.1),
    "Hand": (0.5, 0.6, 0.4),
    "FingerBase": (0.1, 0.4, 0.2),
    "HandFinger1": (0.05, 0.4, 0.05),
    "Thumb": (0.2, 0.3, 0.2),
    "UpLeg": (0.4, 1.0, 0.5),
    "Leg": (0.15, 1.2, 0.08),
    "Foot": (0.2, 0.5, 0.25),
    "ToeBase": (0.05, 0.3, 0.05),
}


def without_side(name: str) -> str:
    """Remove the side from the name of one of the embedded human's joints."""
    return name.removeprefix("Left").removeprefix("Right")


def rest_deviations(skeleton: Skeleton, default: float = 1.0) -> Float[np.ndarray, "J 3"]:
    """Return standard deviations of every joint about the axes of its own frame, radians.

    Joints with the names of the embedded human have those of an adult, other joints `default`. Roots always
    have infinity.
    """
    deviations = np.full((skeleton.num_joints, 3), default)
    for joint, name in enumerate(skeleton.names):
        plain = without_side(name)
        plain = "Thumb" if plain.endswith("Thumb") else plain
        if plain in DEVIATIONS:
            deviations[joint] = DEVIATIONS[plain]
        if skeleton.parents[joint] < 0:
            deviations[joint] = np.inf
    return deviations
