"""Virtual bones: additional rigid bones that move as a nonlinear skin moves its surface."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ...body.kinematics import forward_kinematics
from ...body.pose import Pose
from ...body.skeleton import Skeleton, make_skeleton
from ...body.skin import AbstractSkin, DualQuaternionSkin, SwingTwistSkin
from ...geometry import rotation

#: kinds of joints without a translation
_ROTATION_KINDS = ("ball", "revolute", "universal", "fixed")


class VirtualBones(eqx.Module):
    """S bones, each moved by the skin like a vertex with its own weights.

    The rows of `skin` move a small frame rigidly: they are blends of dual quaternions, with at most one
    joint's swing. The bones are therefore functions of the joints' rotations, and also follow poses to which
    they were not fitted.
    """

    skin: AbstractSkin
    #: parent bone of each virtual bone
    parents: Int[np.ndarray, "S"] = eqx.field(converter=np.asarray)
    #: joint of the skeleton at whose centre each virtual bone is shown
    joints: Int[np.ndarray, "S"] = eqx.field(converter=np.asarray)
    #: one if the bone only rotates about that centre
    turns: Float[np.ndarray, "S"] = eqx.field(converter=np.asarray)

    def __len__(self) -> int:
        return len(self.parents)


def make_virtual_bones(skin: AbstractSkin, skeleton: Skeleton) -> VirtualBones:
    """Make virtual bones from the rows of a skin (see `VirtualBones`).

    **Raises:** `TypeError` if the skin is not a nonlinear one.
    """
    above = np.array(skeleton.parents)
    slides = ~np.isin(skeleton.kinds, _ROTATION_KINDS)
    if isinstance(skin, SwingTwistSkin):
        strength = np.asarray(skin.swing) + np.asarray(skin.twist)
        parents, joints = np.asarray(skin.bases), strength.argmax(1)
        alone = (strength > 0).sum(1) == 1
    elif isinstance(skin, DualQuaternionSkin):
        weights = np.asarray(skin.weights)
        order = np.argsort(-weights, axis=1, kind="stable")[:, : min(2, weights.shape[1])]
        first, second = order[:, 0], order[:, -1]
        # the blend of a bone and its parent rotates about the centre between them
        below = above[first] == second
        parents, joints = np.where(below, second, first), np.where(below, first, second)
        alone = ((weights > 0).sum(1) == 2) & (above[joints] == parents)
    else:
        raise TypeError(
            f"The skin is a {type(skin).__name__}; expected a swing-twist or a dual quaternion skin."
        )
    return VirtualBones(skin, parents, joints, (alone & ~slides[joints]).astype(float))


def bone_frames(skeleton: Skeleton, skin: AbstractSkin, pose: Pose) -> Float[Array, "S 3 4"]:
    """Compute `[R | t]` of a small frame at each row of a skin, from rest to pose, in the world, with the
    pose's scale."""
    count = skin.dominant_bones().shape[0]
    # images of the world's origin and of a metre along each axis
    corners = jnp.concatenate([jnp.zeros((1, 3)), jnp.eye(3)]).astype(skeleton.centres.dtype)
    skin = skin.take(jnp.repeat(jnp.arange(count), 4))
    transforms = forward_kinematics(skeleton, pose)
    carried = skin.deform(jnp.tile(corners, (count, 1)), skeleton, pose, transforms).reshape(count, 4, 3)
    axes = jnp.swapaxes(carried[:, 1:] - carried[:, :1], 1, 2)
    return jnp.concatenate([axes, carried[:, 0, :, None]], 2)


def extended_skeleton(skeleton: Skeleton, bones: VirtualBones) -> Skeleton:
    """Append the virtual bones to the skeleton's joints, each named after its joint."""
    names, counts = list(skeleton.names), {}
    for joint in bones.joints.tolist():
        name = None
        while name is None or name in names:
            counts[joint] = counts.get(joint, 0) + 1
            name = f"{skeleton.names[joint]}_virtual{counts[joint]}"
        names.append(name)
    longer = make_skeleton(
        names,
        [*skeleton.parents, *bones.parents.tolist()],
        [*skeleton.kinds, *("ball" if turns else "free" for turns in bones.turns)],
        np.concatenate([skeleton.centres, np.asarray(skeleton.centres)[bones.joints]]),
        np.concatenate([skeleton.orientations, np.asarray(skeleton.orientations)[bones.joints]]),
        np.concatenate([skeleton.axes, np.asarray(skeleton.axes)[bones.joints]]),
    )
    dtype = skeleton.centres.dtype

    def arrays(s: Skeleton):
        return s.centres, s.orientations, s.axes

    return eqx.tree_at(arrays, longer, tuple(array.astype(dtype) for array in arrays(longer)))


def extended_pose(skeleton: Skeleton, bones: VirtualBones, pose: Pose) -> Pose:
    """Convert a pose of `skeleton` to one of `extended_skeleton(skeleton, bones)`."""
    transforms = forward_kinematics(skeleton, pose)
    frames = bone_frames(skeleton, bones.skin, pose) / pose.scale
    above = transforms.rotations[bones.parents] / pose.scale
    local = jnp.einsum("sba,sbc->sac", above, frames[:, :, :3])
    offsets = frames[:, :, 3] - transforms.translations[bones.parents] / pose.scale
    centres = skeleton.centres[bones.joints]
    moved = jnp.einsum("sba,sb->sa", above, offsets) + jnp.einsum("sab,sb->sa", local, centres) - centres
    moved = jnp.where(bones.turns[:, None] > 0, 0.0, moved)
    return Pose(
        jnp.concatenate([pose.translations, moved]),
        jnp.concatenate([pose.rotations, rotation.from_matrix(local)]),
        pose.scale,
    )
