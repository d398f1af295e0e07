"""A body's soles put on the floor."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..body.body import Body, deform_all
from ..body.pose import Motion, Pose
from .retarget import LOWEST, floor_of

#: joints that come so near to the floor some time bear the body, metres
BEARS = 0.15
#: frames whose surfaces are held at once
BLOCK = 64


def ground(body: Body, motion: Motion, heights: Float[np.ndarray | Array, "F"]) -> Motion:
    """The motion with every frame lifted or lowered until the body's lowest vertex is at its height along y, metres.

    Where the heights are those of another person's soles, feet neither float nor sink in, and jumps stay jumps.

    **Raises:** `ValueError` where there is not one height for each frame.
    """
    if len(heights) != len(motion):
        raise ValueError(f"There are {len(heights)} heights and the motion has {len(motion)} frames.")
    shifts = np.asarray(heights, float) - lowest(body, motion.poses)
    roots = np.flatnonzero(np.array(body.skeleton.parents) < 0)
    # the pose's scale comes last
    dtype = motion.poses.translations.dtype
    lifts = jnp.asarray(shifts / np.asarray(motion.poses.scale, float), dtype)[:, None]
    translations = motion.poses.translations.at[:, roots, 1].add(lifts)
    return Motion(eqx.tree_at(lambda p: p.translations, motion.poses, translations), motion.rate)


def lowest(body: Body, poses: Pose) -> Float[np.ndarray, "F"]:
    """How high the lowest vertex of a body is in each pose of a stack, metres along y."""
    count = len(poses.scale)
    length, found = min(BLOCK, count), []
    for start in range(0, count, max(length, 1)):
        # blocks are of one length, so that they are compiled once
        frames = np.minimum(np.arange(start, start + length), count - 1)
        block = Pose(poses.translations[frames], poses.rotations[frames], poses.scale[frames])
        found.append(np.asarray(deform_all(body, block), float)[..., 1].min(1))
    return np.concatenate([np.zeros(0), *found])[:count]


def sole_heights(paths: Float[np.ndarray | Array, "F J 3"]) -> Float[np.ndarray, "F"]:
    """How high the soles are over the floor, from joints alone, metres: each joint that ever comes near to the floor is as
    high over its sole as it is over the floor when it is lowest (`floor_of`), so ankles tell of heels, and toes of toes."""
    heights = np.asarray(paths, float)[..., 1]
    standing = np.quantile(heights, LOWEST, axis=0)
    bears = standing < floor_of(paths) + BEARS
    return np.min(heights[:, bears] - standing[bears], axis=1)
