"""Left for right."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ..body.pose import Motion, Pose
from ..body.skeleton import Skeleton
from ..body.symmetry import twin_joints
from ..geometry.axes import nearest_axis


def mirror(skeleton: Skeleton, motion: Motion) -> Motion:
    """The motion in a mirror: what the left does the right does, and it goes the other way along the axis from side
    to side, which is the coordinate axis that the skeleton's twins at rest lie along.

    The mirror stands at the world's origin. Exact where left and right are equal; where they are not, joints turn by
    the mirrored angles. Twins are found by names; a joint with no twin is its own.

    **Raises:** `ValueError` where no joint has a twin by name, twins hang on or are of a different kind or are all in one
    place, or the motion moves other joints.
    """
    joints = motion.poses.rotations.shape[1]
    if joints != skeleton.num_joints:
        raise ValueError(
            f"The motion moves {joints} joints and the skeleton has {skeleton.num_joints}; retarget it."
        )
    twins, side = _twins(skeleton), _side(skeleton)
    # a mirror turns about the mirrored axis the other way round
    sign = jnp.asarray(1.0 - 2.0 * side, motion.poses.rotations.dtype)
    flip = jnp.concatenate([jnp.ones(1, sign.dtype), -sign])
    rotations = flip * motion.poses.rotations[:, twins]
    translations = sign * motion.poses.translations[:, twins]
    roots = np.flatnonzero(np.array(skeleton.parents) < 0)
    # a root's place counts, and its centre may be anywhere
    offset = sign * skeleton.centres[twins[roots]] - skeleton.centres[roots]
    translations = translations.at[:, roots].add(offset)
    return Motion(Pose(translations, rotations, motion.poses.scale), motion.rate)


def _twins(skeleton: Skeleton) -> np.ndarray:
    """(J,) the joint on the other side of each."""
    twins = np.arange(skeleton.num_joints)
    for left, right in twin_joints(skeleton.names):
        twins[left], twins[right] = right, left
    if np.array_equal(twins, np.arange(len(twins))):
        raise ValueError(
            f"No joint has a twin on the other side, by the names {', '.join(skeleton.names)}; name them as in LeftArm and RightArm."
        )
    parents, kinds = np.array(skeleton.parents), np.array(skeleton.kinds)
    above = np.where(parents < 0, -1, twins[np.maximum(parents, 0)])
    wrong = (parents[twins] != above) | (kinds[twins] != kinds)
    if wrong.any():
        joint = int(np.argmax(wrong))
        raise ValueError(
            f"The joints '{skeleton.names[joint]}' and '{skeleton.names[twins[joint]]}' are called alike and hang or move "
            "differently; such a skeleton has no mirror image."
        )
    return twins


def _side(skeleton: Skeleton) -> Float[np.ndarray, "3"]:
    """One along the coordinate axis from the right to the left at rest."""
    pairs = np.array(twin_joints(skeleton.names))
    centres = np.asarray(skeleton.centres, float)
    side = nearest_axis(np.abs(centres[pairs[:, 0]] - centres[pairs[:, 1]]).sum(0))
    if not side.any():
        raise ValueError(
            "Left and right joints are in one place at rest, so the sides of this skeleton cannot be told."
        )
    return side
