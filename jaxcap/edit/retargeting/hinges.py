"""Find the hinge axes of elbows and knees."""

import numpy as np
from jaxtyping import Float

from ...body.skeleton import Skeleton

#: least sine of a bend that determines its axis: at rest, and in the motion
BENT, BENDS = 0.1, 0.25
#: least number of frames of a motion, and least share of all bending about one axis
FRAMES, ONE_AXIS = 10, 0.95


def rest_normal(
    first: Float[np.ndarray, "3"], middle: Float[np.ndarray, "3"], last: Float[np.ndarray, "3"]
) -> Float[np.ndarray, "3"] | None:
    """Find the axis about which a limb is bent from its three joints; None for a straight one."""
    upper, lower = middle - first, last - middle
    normal = np.cross(upper, lower)
    length = float(np.linalg.norm(normal))
    reach = float(np.linalg.norm(upper) * np.linalg.norm(lower))
    return normal / length if length > BENT * reach else None


def hinge_normal(
    source: Skeleton,
    limb: tuple[int, int, int],
    places: Float[np.ndarray, "F J 3"],
    turns: Float[np.ndarray, "F 3 3"],
    reference: Float[np.ndarray, "J 3"],
    reference_turn: Float[np.ndarray, "3 3"],
) -> Float[np.ndarray, "3"] | None:
    """Find the hinge axis of a limb's middle joint, for the first bone in the reference pose.

    A revolute joint has its axis. Otherwise it is the mean normal of the plane of both bones in the frame of
    the first bone over the motion, if they bend about one axis; or the normal in the reference pose. Neither
    depends on the frames of the joints, nor on the twist of the second bone.

    **Arguments:** `turns` are the rotations of the first bone in each frame, and `reference_turn` in the
    reference pose.
    """
    first, middle, last = limb
    if source.kinds[middle] == "revolute":
        return reference_turn @ np.asarray(source.axes[middle, 0], float)
    upper, lower = places[:, middle] - places[:, first], places[:, last] - places[:, middle]
    reach = np.linalg.norm(upper, axis=1) * np.linalg.norm(lower, axis=1)
    normals = np.cross(upper, lower) / np.maximum(reach, 1e-12)[:, None]
    sines = np.linalg.norm(normals, axis=1)
    if len(sines) >= FRAMES and sines.max() > BENDS:
        own = np.einsum("fba,fb->fa", turns, normals)
        mean = own.sum(axis=0)
        if np.linalg.norm(mean) > ONE_AXIS * sines.sum():
            return reference_turn @ (mean / np.linalg.norm(mean))
    return rest_normal(reference[first], reference[middle], reference[last])


def twist_between(
    here: Float[np.ndarray, "3"], there: Float[np.ndarray, "3"], bone: Float[np.ndarray, "3"]
) -> float:
    """Compute the angle about a bone that rotates one direction into the half-plane of another, radians."""
    bone = bone / np.linalg.norm(bone)
    here, there = (vector - (vector @ bone) * bone for vector in (here, there))
    return float(np.arctan2(bone @ np.cross(here, there), here @ there))
