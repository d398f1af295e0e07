"""Joints of the human at their anatomical places between landmarks, for people of all traits.

The joints of the morph targets leave their landmarks as traits change: the knees by up to 3 cm. Joints of limbs and the
neck are therefore placed relative to the skin, as those of the man of 25 are, and hips relative to the spines of the pelvis.
"""

import functools
from collections.abc import Mapping

import numpy as np
from jaxtyping import Float

from ...body.people.human import human
from ...geometry.attachment import attached_positions
from .landmarks import landmark_attachment

#: joints of the left side and the middle, and the landmarks whose mean they keep their distance from
LANDMARKS_OF_JOINTS = {
    "LeftLeg": ("left knee_lateral", "left knee_medial"),
    "LeftFoot": ("left ankle_lateral", "left ankle_medial"),
    "LeftArm": ("left acromion",),
    "LeftForeArm": ("left elbow_lateral", "left elbow_medial"),
    "LeftHand": ("left wrist_radial", "left wrist_ulnar"),
    "Neck": ("c7", "jugular_notch"),
}


def joints_by_landmarks(
    vertices: Float[np.ndarray, "V 3"], centres: Float[np.ndarray, "J 3"], resolution: str
) -> Float[np.ndarray, "J 3"]:
    """Move joints of a person at rest to their places relative to the landmarks of the skin, metres.

    `vertices` are of the human of a named `resolution`; joints without landmarks keep their `centres`.
    """
    result = np.array(centres, float)
    names, usual = _joint_names(resolution), _usual_offsets(resolution)
    for joint, middle in _middles(vertices, resolution).items():
        result[joint] = middle + usual[joint]
    for name, centre in hip_centres(_landmark_positions(vertices, resolution)).items():
        result[names.index(name)] = centre
    return result


def hip_centres(at: Mapping[str, Float[np.ndarray, "3"]]) -> dict[str, Float[np.ndarray, "3"]]:
    """Compute the centres of both hips from the spines of the pelvis, metres.

    The regression of Harrington and others (2007), by the width and depth of the pelvis, from magnetic resonance images. The
    joints of the morph targets are 4 cm behind it and 1.5 cm too far to the side.
    """
    left, right = at["left asis"], at["right asis"]
    front, back = 0.5 * (left + right), 0.5 * (at["left psis"] + at["right psis"])
    width, depth = float(np.linalg.norm(left - right)), float(np.linalg.norm(front - back))
    lateral = (left - right) / width
    forward = front - back - ((front - back) @ lateral) * lateral
    forward /= np.linalg.norm(forward)
    middle = front - (0.24 * depth + 0.0099) * forward
    middle = middle - (0.30 * width + 0.0109) * np.cross(forward, lateral)
    half = (0.33 * width + 0.0073) * lateral
    return {"LeftUpLeg": middle + half, "RightUpLeg": middle - half}


def _middles(vertices: Float[np.ndarray, "V 3"], resolution: str) -> dict[int, Float[np.ndarray, "3"]]:
    at = _landmark_positions(vertices, resolution)
    names, found = _joint_names(resolution), {}
    for joint, landmarks in LANDMARKS_OF_JOINTS.items():
        found[names.index(joint)] = np.mean([at[name] for name in landmarks], axis=0)
        if joint.startswith("Left"):
            mirrored = [at[name.replace("left", "right")] for name in landmarks]
            found[names.index(joint.replace("Left", "Right"))] = np.mean(mirrored, axis=0)
    return found


@functools.cache
def _usual_offsets(resolution: str) -> dict[int, Float[np.ndarray, "3"]]:
    """Compute the offsets of the joints of the man of 25 from the means of their landmarks, metres."""
    body = human(resolution=resolution)  # pyright: ignore[reportArgumentType]
    centres = np.asarray(body.skeleton.centres, float)
    middles = _middles(np.asarray(body.vertices, float), resolution)
    return {joint: centres[joint] - middle for joint, middle in middles.items()}


def _joint_names(resolution: str) -> tuple[str, ...]:
    return human(resolution=resolution).skeleton.names  # pyright: ignore[reportArgumentType]


def _landmark_positions(
    vertices: Float[np.ndarray, "V 3"], resolution: str
) -> dict[str, Float[np.ndarray, "3"]]:
    every, hold = landmark_attachment(resolution)
    return dict(zip(every, np.asarray(attached_positions(hold, vertices), float), strict=True))
