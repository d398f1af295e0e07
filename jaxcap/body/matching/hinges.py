"""Find the hinge axes of elbows and knees."""

import numpy as np
from jaxtyping import Float

from ..skeleton import Skeleton

#: least sine of a bend that determines its axis: at rest, and in the motion
MIN_REST_SINE, MIN_MOTION_SINE = 0.1, 0.25
#: least number of frames of a motion, and least share of all bending about one axis
MIN_FRAMES, MIN_AXIS_SHARE = 10, 0.95


def rest_hinge_axis(
    first: Float[np.ndarray, "3"], middle: Float[np.ndarray, "3"], last: Float[np.ndarray, "3"]
) -> Float[np.ndarray, "3"] | None:
    """Find the axis about which a limb is bent from its three joints; None for a straight one."""
    upper, lower = middle - first, last - middle
    normal = np.cross(upper, lower)
    length = float(np.linalg.norm(normal))
    reach = float(np.linalg.norm(upper) * np.linalg.norm(lower))
    return normal / length if length > MIN_REST_SINE * reach else None


def hinge_axis(
    source: Skeleton,
    limb: tuple[int, int, int],
    positions: Float[np.ndarray, "F J 3"],
    rotations: Float[np.ndarray, "F 3 3"],
    reference_positions: Float[np.ndarray, "J 3"],
    reference_rotation: Float[np.ndarray, "3 3"],
) -> Float[np.ndarray, "3"] | None:
    """Find the hinge axis of a limb's middle joint, for the first bone in the reference pose.

    A revolute joint has its axis. Otherwise it is the mean normal of the plane of both bones in the frame of
    the first bone over the motion, if they bend about one axis; or the normal in the reference pose. Neither
    depends on the frames of the joints, nor on the twist of the second bone.

    **Arguments:** `rotations` are the rotations of the first bone in each frame, and `reference_rotation` in the
    reference pose.
    """
    first, middle, last = limb
    if source.kinds[middle] == "revolute":
        return reference_rotation @ np.asarray(source.axes[middle, 0], float)
    upper, lower = positions[:, middle] - positions[:, first], positions[:, last] - positions[:, middle]
    reach = np.linalg.norm(upper, axis=1) * np.linalg.norm(lower, axis=1)
    normals = np.cross(upper, lower) / np.maximum(reach, 1e-12)[:, None]
    sines = np.linalg.norm(normals, axis=1)
    if len(sines) >= MIN_FRAMES and sines.max() > MIN_MOTION_SINE:
        own = np.einsum("fba,fb->fa", rotations, normals)
        mean = own.sum(axis=0)
        if np.linalg.norm(mean) > MIN_AXIS_SHARE * sines.sum():
            return reference_rotation @ (mean / np.linalg.norm(mean))
    return rest_hinge_axis(reference_positions[first], reference_positions[middle], reference_positions[last])


def twist_between(
    start: Float[np.ndarray, "3"], end: Float[np.ndarray, "3"], bone: Float[np.ndarray, "3"]
) -> float:
    """Compute the angle about a bone that rotates one direction into the half-plane of another, radians."""
    bone = bone / np.linalg.norm(bone)
    start, end = (vector - (vector @ bone) * bone for vector in (start, end))
    return float(np.arctan2(bone @ np.cross(start, end), start @ end))
