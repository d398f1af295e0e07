"""Place the soles of a body on the floor."""

import numpy as np
from jaxtyping import Array, Float

from ...arguments import checked
from ...body.body import Body, posed_vertices
from ...body.kinematics import joint_paths
from ...body.matching.plan import UP
from ...body.pose import Motion, Pose, shift_roots, take_poses
from ...body.skeleton import Skeleton
from .retarget import FLOOR_QUANTILE, floor_height

#: joints that come this near to the floor at some time bear the body, metres
BEARING_HEIGHT = 0.15
#: frames whose surfaces are in memory at once
BLOCK = 64


@checked
def ground(
    body: Body,
    motion: Motion,
    heights: Float[np.ndarray | Array, "F"],
    up: Float[np.ndarray, "3"] = UP,
) -> Motion:
    """Translate every frame along `up` so that the body's lowest vertex is at its given height, metres.

    With the heights of another person's soles, feet neither float nor penetrate the floor, and jumps are
    preserved.

    **Raises:** `ValueError` if there is not one height for each frame.
    """
    if len(heights) != len(motion):
        raise ValueError(
            f"There are {len(heights)} heights, but the motion has {len(motion)} frames; give one height for each frame."
        )
    lifts = np.asarray(heights, float) - lowest_heights(body, motion.poses, up)
    return Motion(shift_roots(body.skeleton, motion.poses, lifts[:, None] * up), motion.rate)


@checked
def lowest_heights(body: Body, poses: Pose, up: Float[np.ndarray, "3"] = UP) -> Float[np.ndarray, "F"]:
    """Compute the height of the lowest vertex of a body in each pose of a stack, metres along `up`."""
    count = len(poses.scale)
    length, found = min(BLOCK, count), []
    for start in range(0, count, max(length, 1)):
        # blocks have the same length, so that they are compiled once
        frames = np.minimum(np.arange(start, start + length), count - 1)
        block = take_poses(poses, frames)
        found.append((np.asarray(posed_vertices(body, block), float) @ up).min(1))
    return np.concatenate([np.zeros(0), *found])[:count]


@checked
def motion_floor_height(owner: Body | Skeleton, poses: Pose, up: Float[np.ndarray, "3"] = UP) -> float:
    """Estimate the height of a motion's floor along `up` (`floor_height`), metres, from the vertices of a body or
    the joints of a skeleton."""
    if isinstance(owner, Skeleton):
        return floor_height(joint_paths(owner, poses), up)
    return floor_height(lowest_heights(owner, poses, up)[:, None, None] * up, up)


@checked
def sole_heights(
    paths: Float[np.ndarray | Array, "F J 3"], up: Float[np.ndarray, "3"] = UP
) -> Float[np.ndarray, "F"]:
    """Estimate the heights of the soles above the floor from joints alone, metres.

    The height of each bearing joint above its sole is its lowest height above the floor (`floor_height`). Ankles
    therefore represent heels, and toe joints the toes. Joints that never come near the floor are ignored.
    """
    heights = np.asarray(paths, float) @ up
    standing = np.quantile(heights, FLOOR_QUANTILE, axis=0)
    bears = standing < floor_height(paths, up) + BEARING_HEIGHT
    return np.min(heights[:, bears] - standing[bears], axis=1)
