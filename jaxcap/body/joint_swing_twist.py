"""Decomposition of each joint's own motion into a twist and a swing."""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from ..geometry import dual_quaternions, rotation
from ..small_matrices import apply_small
from .pose import Pose
from .skeleton import Skeleton


class SwingTwist(NamedTuple):
    """The joints' own motions, `swing after twist`, in the rest frame of the world."""

    #: unit dual quaternions of the rotations about the joints' own x axes through their centres
    twists: Float[Array, "*joints 8"]
    #: `[R | t]` of the rotations about perpendiculars of those axes, then the joints' translations
    swings: Float[Array, "*joints 3 4"]


def decompose_joints(skeleton: Skeleton, pose: Pose) -> SwingTwist:
    """Decompose every joint's own motion, `Translate(t) . Rot(q about c)`, into swing after twist."""
    return decompose_motions(pose.rotations, pose.translations, skeleton.centres, skeleton.orientations)


def decompose_motions(
    rotations: Float[Array, "*joints 4"],
    translations: Float[Array, "*joints 3"],
    centres: Float[Array, "*joints 3"],
    orientations: Float[Array, "*joints 4"],
) -> SwingTwist:
    """Decompose motions of joints into swing and twist (Adaptation, eqs. 3.13 and 3.14); metres, unit
    quaternions.

    The paper writes `o* q o` for the map from a joint's frame into the world. So its `o` is the inverse of
    `Skeleton.orientations`, which map from the joint's frame into the world at rest. The pose's `q` is
    already in the axes of the world. In the joint's frame it is `o* q o` with *our* `o`; its part
    `(q_w, q_x, 0, 0)` is mapped back. This is the twist about the axis `o e_x`, and needs no change of
    frame.

    Translations of the joint (kinds `free` and `translate`) belong to the swing, so that swing and twist of
    weight one are the whole motion of the joint.

    The twist is the identity where it is not defined (a swing by pi).
    """
    ahead = jnp.broadcast_to(jnp.array([1.0, 0.0, 0.0], orientations.dtype), centres.shape)
    axes = rotation.rotate(orientations, ahead)
    swings, twists = rotation.swing_twist(rotations, axes)
    matrices = rotation.to_matrix(swings)
    shifts = translations + centres - apply_small(matrices, centres)
    return SwingTwist(
        dual_quaternions.about_centre(twists, centres), jnp.concatenate([matrices, shifts[..., None]], -1)
    )
