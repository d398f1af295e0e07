"""Forward kinematics, batched over all joints of a tree."""

from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..arguments import checked
from ..geometry import rotation
from ..small_matrices import apply_small, multiply_small
from .pose import Pose, universal_angles
from .skeleton import Skeleton


class Transforms(eqx.Module):
    """Rigid motions of bones from rest to pose: `x' = rotations x + translations`.

    Both include the pose's scale; the motions are similarities where it is not one.
    """

    rotations: Float[Array, "J 3 3"]
    translations: Float[Array, "J 3"]


@checked
@partial(jax.jit, inline=True)
def forward_kinematics(skeleton: Skeleton, pose: Pose) -> Transforms:
    """Compute the world transform of every bone, `T_j = T_parent . Translate(t_j) . Rot(q_j about c_j)`
    (Kineben, eq. 1; Adaptation, section 3.1). The pose's scale is applied last.

    Transforms are composed by pointer doubling: a tree of `n` levels takes `log2 n` products batched over
    all joints, and few operations compile fast.
    """
    rotations = rotation.to_matrix(pose.rotations)
    centres = skeleton.centres
    translations = pose.translations + centres - apply_small(rotations, centres)
    # each joint's transform is relative to `ancestors`; the row after the last joint is the world
    world = skeleton.num_joints
    ancestors = np.array([*skeleton.parents, world])
    ancestors[ancestors < 0] = world
    motions = jnp.concatenate([rotations, translations[:, :, None]], 2)
    # a constant, as an array that is computed in a loop stands there once for each call of this function
    still = np.eye(4, dtype=motions.dtype)
    below = np.broadcast_to(still[3], (world, 1, 4))
    motions = jnp.concatenate([jnp.concatenate([motions, below], 1), still[None]])
    while np.any(ancestors < world):
        motions = multiply_small(motions[ancestors], motions)
        ancestors = ancestors[ancestors]
    motions = pose.scale * motions[:world]
    return Transforms(motions[:, :3, :3], motions[:, :3, 3])


@partial(jax.jit, inline=True)
def joint_positions(skeleton: Skeleton, transforms: Transforms) -> Float[Array, "J 3"]:
    """Compute the world positions of the joint centres, metres."""
    return apply_small(transforms.rotations, skeleton.centres) + transforms.translations


@partial(jax.jit, inline=True)
def world_axes(
    skeleton: Skeleton, pose: Pose, transforms: Transforms
) -> tuple[Float[Array, "J 3 3"], Float[Array, "J 3 3"]]:
    """Compute the world directions of each joint's translation and rotation parameters, as
    `(translations, rotations)`, each `(J, number, 3)`.

    Rotation parameter `i` of a tangent rotates all descendants of joint `j` about `rotations[j, i]` through
    the joint's centre. For a ball joint these are the columns of its total rotation `R_1..i` (Kineben, eq.
    13). For a revolute joint it is its axis, rotated by its ancestors (eq. 10). Parameters that a kind does
    not have are zero.
    """
    scale = pose.scale
    whole = transforms.rotations / scale
    parents = np.array(skeleton.parents)
    parent_r = jnp.where(
        (parents < 0)[:, None, None], jnp.eye(3, dtype=whole.dtype), whole[np.maximum(parents, 0)]
    )
    kinds = np.array(skeleton.kinds)
    moves = np.isin(kinds, ["translate", "free"])[:, None, None]
    translations = jnp.where(moves, scale * jnp.swapaxes(parent_r, -1, -2), 0.0)
    free = jnp.swapaxes(whole, -1, -2)
    first = apply_small(parent_r, skeleton.axes[:, 0])
    half_turned = rotation.about_axis(skeleton.axes[:, 0], universal_angles(skeleton, pose)[:, 0])
    second = apply_small(parent_r, rotation.rotate(half_turned, skeleton.axes[:, 1]))
    none = jnp.zeros_like(first)
    kind = kinds[:, None, None]
    rotations = jnp.where(np.isin(kind, ["ball", "free"]), free, 0.0)
    rotations = jnp.where(kind == "revolute", jnp.stack([first, none, none], 1), rotations)
    rotations = jnp.where(kind == "universal", jnp.stack([first, second, none], 1), rotations)
    return translations, rotations


@jax.jit
def joint_paths(skeleton: Skeleton, poses: Pose) -> Float[Array, "F J 3"]:
    """Compute the world positions of the joint centres in every pose of a stack, metres."""
    return jax.lax.map(lambda pose: joint_positions(skeleton, forward_kinematics(skeleton, pose)), poses)
