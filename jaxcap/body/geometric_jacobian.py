"""How the joints of a body answer to unknown numbers: of a pose, or of the joints themselves.

A skin needs no more than this to say how its vertices move with these numbers
(`AbstractSkin.jacobian`): all that hangs below a joint moves along a linear field of the
world, `x -> a x x + b` (Kineben, eqs. 8 to 13 and 41, has it as a 4 x 4 operator), and the
surface beside the joint by the rates of the joint's own twist and swing.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ..geometry import rotation
from .joint_swing_twist import Split, split_joints, split_motions
from .kinematics import Transforms, joint_positions, world_axes
from .pose import Pose, retract
from .skeleton import Skeleton, dof_layout


class Rates(eqx.Module):
    """Rates of N numbers, each of which belongs to one joint; metres and radians a unit."""

    #: the joint of each number
    joints: tuple[int, ...] = eqx.field(static=True)
    #: the field that moves all of the world below that joint, `x -> angular x x + linear`
    angular: Float[Array, "N 3"]
    linear: Float[Array, "N 3"]
    #: rate of that joint's own twist, a dual quaternion, and of its own swing (`Split`)
    twist: Float[Array, "N 8"]
    swing: Float[Array, "N 3 4"]


def pose_rates(skeleton: Skeleton, pose: Pose, transforms: Transforms) -> Rates:
    """Rates by the D numbers `d` of `retract(skeleton, pose, d)` at `d = 0`, as `dof_layout` has them.

    For a turn about the world axis `a` through the joint's centre `c` the field is
    `(a, -a x c)` (Kineben, eqs. 10 and 13), for a shift along `a` it is `(0, a)` (eq. 8, with
    the axis carried by the joint's ancestors and by the scale).
    """
    joints, numbers, turning = _slots(skeleton)
    shifts, turns = world_axes(skeleton, pose, transforms)
    centres = joint_positions(skeleton, transforms)[joints]
    axes = jnp.where(turning[:, None], turns[joints, numbers], shifts[joints, numbers])
    angular = jnp.where(turning[:, None], axes, 0.0)
    linear = jnp.where(turning[:, None], jnp.cross(centres, axes), axes)
    # joints do not share numbers, so one pass moves a number of each joint at once
    kinds = 3 * turning + numbers
    directions = jnp.asarray(np.arange(6)[:, None] == kinds, centres.dtype)
    split = _rates(lambda d: split_joints(skeleton, retract(skeleton, pose, d)), directions)
    return Rates(tuple(joints.tolist()), angular, linear, *(rate[kinds, joints] for rate in split))


def joint_rates(skeleton: Skeleton, pose: Pose, transforms: Transforms) -> Rates:
    """Rates by 6 J numbers, joint by joint: three of the joint's centre, along the axes of the
    world at rest, and three of its orientation, `o <- o exp(w)`. The pose stays as it is.

    A centre that is shifted by `e` shifts all below its joint by `R_parent (I - R) e`; an
    orientation changes nothing but where twist ends and swing begins.
    """
    count, parents = skeleton.num_joints, np.array(skeleton.parents)
    dtype = skeleton.centres.dtype
    top = (parents < 0)[:, None, None]
    above = jnp.where(top, pose.scale * jnp.eye(3, dtype=dtype), transforms.rotations[np.maximum(parents, 0)])
    fields = jnp.swapaxes(above - transforms.rotations, 1, 2)
    linear = jnp.concatenate([fields, jnp.zeros_like(fields)], 1).reshape(-1, 3)

    def moved(d):
        d = jnp.broadcast_to(d, (count, 6))
        turned = rotation.multiply(skeleton.orientations, rotation.exp(d[:, 3:]))
        return split_motions(pose.rotations, pose.translations, skeleton.centres + d[:, :3], turned)

    split = _rates(moved, jnp.eye(6, dtype=dtype))
    twist, swing = (jnp.moveaxis(rate, 0, 1).reshape(-1, *rate.shape[2:]) for rate in split)
    return Rates(tuple(np.repeat(np.arange(count), 6).tolist()), jnp.zeros_like(linear), linear, twist, swing)


def stack_rates(*rates: Rates) -> Rates:
    """All numbers of several `Rates`, one after the other."""
    joints = sum((some.joints for some in rates), ())
    moving = [(some.angular, some.linear, some.twist, some.swing) for some in rates]
    return Rates(joints, *(jnp.concatenate(parts) for parts in zip(*moving, strict=True)))


def take_rates(rates: Rates, numbers: Int[np.ndarray, "M"]) -> Rates:
    """Some of the numbers, in their order; which ones must be known when traced."""
    joints = tuple(rates.joints[number] for number in numbers.tolist())
    moving = (rates.angular, rates.linear, rates.twist, rates.swing)
    return Rates(joints, *(some[numbers] for some in moving))


def bones_below(skeleton: Skeleton, rates: Rates) -> Float[Array, "J N"]:
    """One where a bone moves with a number's joint."""
    return jnp.asarray(skeleton.descent[list(rates.joints)].T, rates.linear.dtype)


def field_rows(
    points: Float[Array, "V 3"], directions: Float[Array, "V R 3"], rates: Rates
) -> Float[Array, "V R N"]:
    """`n . (a x p + b)` along directions `n`, as if all points `p` hung below all joints: with
    `n . (a x p) = a . (p x n)`, one product of wrenches and twists."""
    x, y, z = (points[:, None, i] for i in range(3))
    nx, ny, nz = (directions[:, :, i] for i in range(3))
    wrench = jnp.stack([y * nz - z * ny, z * nx - x * nz, x * ny - y * nx, nx, ny, nz], -1)
    return wrench @ jnp.concatenate([rates.angular, rates.linear], 1).T


def _rates(function, directions: Float[Array, "K D"]) -> Split:
    """The derivative of a `Split` at zero along each direction."""
    still = jnp.zeros_like(directions[0])
    return jax.vmap(lambda direction: jax.jvp(function, (still,), (direction,))[1])(directions)


def _slots(skeleton: Skeleton) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The joint of each number of a tangent, which of its axes it is, whether it turns."""
    layout = dof_layout(skeleton)
    numbers = np.zeros(skeleton.num_dofs, int)
    turning = np.zeros(skeleton.num_dofs, bool)
    for slots, turns in ((layout.translations, False), (layout.rotations, True)):
        joint, number = np.nonzero(slots < skeleton.num_dofs)
        numbers[slots[joint, number]] = number
        turning[slots[joint, number]] = turns
    return layout.joints, numbers, turning
