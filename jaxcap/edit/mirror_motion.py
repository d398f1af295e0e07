"""Mirror motions left to right."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ..arguments import checked
from ..body.pose import Motion, Pose
from ..body.skeleton import Skeleton
from ..body.symmetry import left_right_pairs_by_name
from ..geometry.axes import nearest_axis


@checked
def mirror(skeleton: Skeleton, motion: Motion) -> Motion:
    """Mirror a motion: exchange left and right, and reflect positions along the lateral axis.

    The lateral axis is the coordinate axis along which the skeleton's left and right joints lie at rest. The
    mirror plane goes through the world's origin. The result is exact for a symmetric skeleton; otherwise
    joints rotate by the mirrored angles. Pairs are found by names; a joint without a counterpart is mapped to
    itself.

    **Raises:** `ValueError` if no joint has a counterpart by name, counterparts have unlike parents or kinds
    or all coincide, or the motion has other joints.
    """
    twins, side = _counterpart_joints(skeleton), _lateral_axis(skeleton)
    # a reflection reverses rotations about the axes in the mirror plane
    sign = jnp.asarray(1.0 - 2.0 * side, motion.poses.rotations.dtype)
    flip = jnp.concatenate([jnp.ones(1, sign.dtype), -sign])
    rotations = flip * motion.poses.rotations[:, twins]
    translations = sign * motion.poses.translations[:, twins]
    roots = np.flatnonzero(np.array(skeleton.parents) < 0)
    # a root's position is in the world, and its centre may be anywhere
    offset = sign * skeleton.centres[twins[roots]] - skeleton.centres[roots]
    translations = translations.at[:, roots].add(offset)
    return Motion(Pose(translations, rotations, motion.poses.scale), motion.rate)


def _counterpart_joints(skeleton: Skeleton) -> np.ndarray:
    """Find the joint on the other side of each joint, (J,)."""
    twins = np.arange(skeleton.num_joints)
    for left, right in left_right_pairs_by_name(skeleton.names):
        twins[left], twins[right] = right, left
    if np.array_equal(twins, np.arange(len(twins))):
        raise ValueError(
            f"No joint has a counterpart on the other side, by the names {', '.join(skeleton.names)}; give names as "
            "in LeftArm and RightArm."
        )
    parents, kinds = np.array(skeleton.parents), np.array(skeleton.kinds)
    above = np.where(parents < 0, -1, twins[np.maximum(parents, 0)])
    wrong = (parents[twins] != above) | (kinds[twins] != kinds)
    if wrong.any():
        joint = int(np.argmax(wrong))
        raise ValueError(
            f"The joints '{skeleton.names[joint]}' and '{skeleton.names[twins[joint]]}' are counterparts by their "
            "names, but have unlike parents or kinds; such a skeleton has no mirror image."
        )
    return twins


def _lateral_axis(skeleton: Skeleton) -> Float[np.ndarray, "3"]:
    """Find the coordinate axis from right to left at rest, without its sign."""
    pairs = np.array(left_right_pairs_by_name(skeleton.names))
    centres = np.asarray(skeleton.centres, float)
    side = nearest_axis(np.abs(centres[pairs[:, 0]] - centres[pairs[:, 1]]).sum(0))
    if not side.any():
        raise ValueError(
            "Left and right joints have the same positions at rest, so the lateral axis of this skeleton cannot be "
            "determined."
        )
    return side
