"""Shoulder and elbow rotations from four markers of an arm, without a skeleton (Limits, section 3.2)."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from ...arguments import checked
from ...errors import InputError
from ...observe.markers import MarkerFrames
from .samples import BLOCK_SECONDS, JointSamples

#: sine of the least angle at which markers define a plane
MIN_BEND = 0.05


@checked
def arm_samples(
    frames: MarkerFrames,
    markers: Sequence[str],
    trunk: Sequence[str],
    names: tuple[str, str] = ("shoulder", "elbow"),
) -> tuple[JointSamples, JointSamples]:
    """Compute a shoulder's rotations, and an elbow's coupled to it, in the frames with all markers visible.

    **Arguments:** `markers` are the labels of shoulder, upper arm, elbow and forearm; `trunk` three markers
    of the shoulder's parent. The shoulder's first axis goes from shoulder to upper arm, its second is the
    normal of the triangle of upper arm, elbow and forearm. In that frame the elbow's two angles give the
    direction of the forearm. Its twist needs a fifth marker, which the paper's arm does not have.

    **Raises:** `InputError` where a label is missing, or no frame shows all of them with the elbow bent.
    """
    if len(markers) != 4 or len(trunk) != 3:
        raise InputError(
            f"There are {len(markers)} markers of the arm and {len(trunk)} of the trunk; expected shoulder, upper "
            "arm, elbow and forearm, and three of the trunk."
        )
    for label in (*markers, *trunk):
        if label not in frames.labels:
            raise InputError(f"There is no marker '{label}'; the file has {', '.join(frames.labels)}.")
    columns = [frames.labels.index(label) for label in (*markers, *trunk)]
    positions = np.asarray(frames.positions, float)[:, columns]
    first = _unit(positions[:, 1] - positions[:, 0])
    normal = np.cross(positions[:, 2] - positions[:, 1], positions[:, 3] - positions[:, 2])
    sides = np.linalg.norm(positions[:, 2] - positions[:, 1], axis=1) * np.linalg.norm(
        positions[:, 3] - positions[:, 2], axis=1
    )
    bent = np.linalg.norm(normal, axis=1) > MIN_BEND * np.maximum(sides, 1e-12)
    good = np.asarray(frames.visible)[:, columns].all(1) & bent
    if not good.any():
        raise InputError(
            f"No frame shows {', '.join((*markers, *trunk))} at once with the elbow bent; a straight arm does not "
            "define the plane of the elbow."
        )
    positions, first, normal = positions[good], first[good], normal[good]
    arm = _frame(first, normal)
    body = _frame(
        _unit(positions[:, 5] - positions[:, 4]),
        np.cross(positions[:, 5] - positions[:, 4], positions[:, 6] - positions[:, 4]),
    )
    shoulder = body.inv() * arm
    pointing = arm.inv().apply(_unit(positions[:, 3] - positions[:, 2]))
    # about the normal, then up out of the plane
    flexion = np.arctan2(pointing[:, 2], pointing[:, 0])
    lift = np.arcsin(np.clip(pointing[:, 1], -1, 1))
    axes = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, 1.0]])
    elbow = Rotation.from_rotvec(flexion[:, None] * axes[0]) * Rotation.from_rotvec(lift[:, None] * axes[1])
    blocks = (np.flatnonzero(good) / (BLOCK_SECONDS * frames.rate)).astype(int)
    upper = JointSamples(names[0], "ball", np.eye(3)[:2], shoulder.as_quat(scalar_first=True), blocks)
    lower = JointSamples(names[1], "universal", axes, elbow.as_quat(scalar_first=True), blocks, upper)
    return upper, lower


def _frame(first: Float[np.ndarray, "F 3"], second: Float[np.ndarray, "F 3"]) -> Rotation:
    """Build right-handed frames from a first axis and the orthogonal part of a second."""
    second = _unit(second - np.sum(second * first, -1, keepdims=True) * first)
    return Rotation.from_matrix(np.stack([first, second, np.cross(first, second)], -1))


def _unit(x: Float[np.ndarray, "F 3"]) -> Float[np.ndarray, "F 3"]:
    return x / np.maximum(np.linalg.norm(x, axis=-1, keepdims=True), 1e-12)
