"""Euler angles of the joints of a motion, and of rotations."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from ..arguments import checked
from ..errors import InputError
from ..geometry import rotation
from .pose import Motion, Pose
from .skeleton import Skeleton

#: sine of the distance from gimbal lock below which the third angle is zero
GIMBAL_LOCK = 1e-6


@checked
def joint_euler_angles(
    skeleton: Skeleton,
    motion: Motion | Pose,
    order: str = "zxy",
    frames: Float[Array, "J 4"] | None = None,
) -> Float[Array, "*frames J 3"]:
    """Compute the Euler angles of every joint against its parent, zero at rest, radians.

    The rotation of a joint is `R = Rot(order[0], a) Rot(order[1], b) Rot(order[2], c)`: intrinsic rotations
    about the axes of the joint's frame, the first angle about the parent's axis. The angles of a motion are
    unwrapped over its frames. The middle angle lies within a quarter of a turn; where it reaches it (gimbal
    lock), the third angle is zero.

    **Arguments:** `order`, three different letters of x, y and z; `frames`, unit quaternions of the axes in
    the rest frame of the world, one for each joint. The default is the world's axes at rest.
    `skeleton.orientations` are the joints' own axes, x along the bone. `jaxcap.joint_angles` has the angles of
    biomechanics instead, between anatomical axes.

    **Raises:** `InputError` if `order` is none of the six orders.
    """
    if sorted(order) != ["x", "y", "z"]:
        raise InputError(
            f"joint_euler_angles: `order` is '{order}'; expected three different axes, such as 'zxy'."
        )
    pose = motion.poses if isinstance(motion, Motion) else motion
    rotations = pose.rotations
    if frames is not None:
        frames = jnp.broadcast_to(frames, rotations.shape)
        rotations = rotation.multiply(rotation.conjugate(frames), rotation.multiply(rotations, frames))
    angles = euler_angles(rotations, order)
    return jnp.unwrap(angles, axis=0) if pose.rotations.ndim > 2 else angles


def euler_angles(rotations: Float[Array, "*shape 4"], order: str) -> Float[Array, "*shape 3"]:
    """Decompose rotations into three intrinsic rotations about different axes, radians."""
    return matrix_euler_angles(rotation.to_matrix(rotations), order)


def matrix_euler_angles(m: Float[Array, "*shape 3 3"], order: str) -> Float[Array, "*shape 3"]:
    """Decompose rotation matrices as `euler_angles` does quaternions."""
    i, j, k = ("xyz".index(axis) for axis in order)
    # the sign of the permutation: even orders have a positive sine of the middle angle in entry (i, k)
    sign = 1.0 if (j - i) % 3 == 1 else -1.0
    squared = m[..., i, i] ** 2 + m[..., i, j] ** 2
    free = squared > GIMBAL_LOCK**2
    # both branches of each `where` are finite, so that derivatives are
    across = jnp.where(free, jnp.sqrt(jnp.where(free, squared, 1.0)), 0.0)
    middle = jnp.arctan2(sign * m[..., i, k], across)
    first = jnp.arctan2(
        jnp.where(free, -sign * m[..., j, k], sign * m[..., k, j]),
        jnp.where(free, m[..., k, k], m[..., j, j]),
    )
    third = jnp.arctan2(jnp.where(free, -sign * m[..., i, j], 0.0), jnp.where(free, m[..., i, i], 1.0))
    return jnp.stack([first, middle, third], -1)
