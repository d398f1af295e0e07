"""What a joint does to the surface beside it, split into a twist and a swing."""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from ..geometry import dualquat, rotation
from .pose import Pose
from .skeleton import Skeleton


class Split(NamedTuple):
    """The joints' own motions, `swing after twist`, in the rest frame of the world."""

    #: unit dual quaternions of the turns about the joints' own x axes through their centres
    twists: Float[Array, "*joints 8"]
    #: `[R | t]` of the turns about perpendiculars of those axes, then the joints' shifts
    swings: Float[Array, "*joints 3 4"]


def split_joints(skeleton: Skeleton, pose: Pose) -> Split:
    """The own motion of every joint, `Translate(t) . Rot(q about c)`, as swing after twist."""
    return split_motions(pose.rotations, pose.translations, skeleton.centres, skeleton.orientations)


def split_motions(
    rotations: Float[Array, "*joints 4"],
    translations: Float[Array, "*joints 3"],
    centres: Float[Array, "*joints 3"],
    orientations: Float[Array, "*joints 4"],
) -> Split:
    """Swing and twist of joints (Adaptation, eqs. 3.13 and 3.14), metres and unit quaternions.

    The paper writes `o* q o` for the way from a joint's frame into the world, so its `o` is
    the inverse of `Skeleton.orientations`, which lead from the joint's frame into the world
    at rest. The pose's `q` is in the world's axes already: in the joint's frame it is
    `o* q o` with *our* `o`, of which `(q_w, q_x, 0, 0)` is taken and carried back. That is
    the twist about the axis `o e_x`, with no change of frame to be made.

    Shifts of the joint (kinds `free` and `translate`) belong to the swing, so that swing and
    twist by whole weights are the whole motion of the joint.

    Where the twist is not defined (a swing by pi) it is taken to be none.
    """
    ahead = jnp.broadcast_to(jnp.array([1.0, 0.0, 0.0], orientations.dtype), centres.shape)
    axes = rotation.rotate(orientations, ahead)
    swings, twists = rotation.swing_twist(rotations, axes)
    matrices = rotation.to_matrix(swings)
    shifts = translations + centres - jnp.einsum("...ab,...b->...a", matrices, centres)
    return Split(dualquat.about_centre(twists, centres), jnp.concatenate([matrices, shifts[..., None]], -1))
