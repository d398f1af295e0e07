"""Directions of bones at rest, by which the rest poses of two skeletons are compared."""

import numpy as np
from jaxtyping import Float

from ...body.skeleton import Skeleton

#: largest angle between the bones of two skeletons with the same rest pose, radians: people differ by less
MAX_REST_ANGLE = float(np.radians(20.0))


def bone_direction(skeleton: Skeleton, joint: str) -> Float[np.ndarray, "3"]:
    """Compute the unit direction at rest from a joint to the mean of its children; zero at the end of a chain."""
    centres = np.asarray(skeleton.centres, float)
    index = skeleton.index(joint)
    below = [child for child, parent in enumerate(skeleton.parents) if parent == index]
    if not below:
        return np.zeros(3)
    bone = centres[below].mean(0) - centres[index]
    length = np.linalg.norm(bone)
    return bone / length if length > 1e-6 else np.zeros(3)


def bone_angle(one: Float[np.ndarray, "3"], other: Float[np.ndarray, "3"]) -> float:
    """Compute the angle between two directions, radians; zero where one of them is not known."""
    if not (one.any() and other.any()):
        return 0.0
    return float(np.arctan2(np.linalg.norm(np.cross(one, other)), one @ other))
