"""Geometric Jacobians: rates of the joints by parameters of a pose or of the joints themselves.

A skin needs only these rates for the velocities of its vertices (`AbstractSkin.jacobian`). All descendants
of a joint move along a linear field of the world, `x -> a x x + b` (Kineben, eqs. 8 to 13 and 41, writes it
as a 4 x 4 operator). The surface around the joint moves by the rates of the joint's own twist and swing.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ..geometry import rotation
from ..small_matrices import apply_small, multiply_small
from .joint_swing_twist import SwingTwist, decompose_joints, decompose_motions
from .kinematics import Transforms, joint_positions, world_axes
from .pose import Pose
from .retraction import retract
from .skeleton import Skeleton, dof_layout


class GeometricJacobian(eqx.Module):
    """Rates of N parameters, each of which belongs to one joint; metres and radians per unit."""

    #: the joint of each parameter
    joints: tuple[int, ...] = eqx.field(static=True)
    #: true for parameters that change the rotation of their joint
    turning: tuple[bool, ...] = eqx.field(static=True)
    #: velocity field of that joint's descendants in the world, `x -> angular x x + linear`
    angular: Float[Array, "N 3"]
    linear: Float[Array, "N 3"]
    #: rates of that joint's own twist, a dual quaternion, and of its own swing (`Split`)
    twist: Float[Array, "N 8"]
    swing: Float[Array, "N 3 4"]


def pose_jacobian(skeleton: Skeleton, pose: Pose, transforms: Transforms) -> GeometricJacobian:
    """Compute the rates by the D parameters `d` of `retract(skeleton, pose, d)` at `d = 0`, in the order of
    `dof_layout`.

    For a rotation about the world axis `a` through the joint's centre `c` the field is `(a, -a x c)`
    (Kineben, eqs. 10 and 13). For a translation along `a` it is `(0, a)` (eq. 8, with the axis transformed
    by the joint's ancestors and by the scale).
    """
    joints, numbers, turning = _parameter_axes(skeleton)
    shifts, turns = world_axes(skeleton, pose, transforms)
    centres = joint_positions(skeleton, transforms)[joints]
    axes = jnp.where(turning[:, None], turns[joints, numbers], shifts[joints, numbers])
    angular = jnp.where(turning[:, None], axes, 0.0)
    linear = jnp.where(turning[:, None], jnp.cross(centres, axes), axes)
    # joints share no parameters, so one pass differentiates by one parameter of every joint
    kinds = 3 * turning + numbers
    directions = jnp.asarray(np.arange(6)[:, None] == kinds, centres.dtype)
    split = _differentiate_swing_twist(
        lambda d: decompose_joints(skeleton, retract(skeleton, pose, d)), directions
    )
    return GeometricJacobian(
        tuple(joints.tolist()),
        tuple(turning.tolist()),
        angular,
        linear,
        *(rate[kinds, joints] for rate in split),
    )


def joint_jacobian(skeleton: Skeleton, pose: Pose, transforms: Transforms) -> GeometricJacobian:
    """Compute the rates by 6 J parameters of the joints: for each joint, three of its centre along the axes
    of the world at rest, and three of its orientation, `o <- o exp(w)`. The pose stays as it is.

    A translation of a joint's centre by `e` translates all of its descendants by `R_parent (I - R) e`. A
    change of orientation changes only the split into twist and swing.
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
        return decompose_motions(pose.rotations, pose.translations, skeleton.centres + d[:, :3], turned)

    split = _differentiate_swing_twist(moved, jnp.eye(6, dtype=dtype))
    twist, swing = (jnp.moveaxis(rate, 0, 1).reshape(-1, *rate.shape[2:]) for rate in split)
    return GeometricJacobian(
        tuple(np.repeat(np.arange(count), 6).tolist()),
        (False,) * (6 * count),
        jnp.zeros_like(linear),
        linear,
        twist,
        swing,
    )


def concatenate_jacobians(*rates: GeometricJacobian) -> GeometricJacobian:
    """Concatenate the parameters of several `GeometricJacobian`."""
    joints = sum((some.joints for some in rates), ())
    turning = sum((some.turning for some in rates), ())
    moving = [(some.angular, some.linear, some.twist, some.swing) for some in rates]
    return GeometricJacobian(
        joints, turning, *(jnp.concatenate(parts) for parts in zip(*moving, strict=True))
    )


def select_parameters(rates: GeometricJacobian, indices: Int[np.ndarray, "M"]) -> GeometricJacobian:
    """Select some of the parameters, in the given order; `indices` must be known at trace time."""
    joints, turning = (
        tuple(some[number] for number in indices.tolist()) for some in (rates.joints, rates.turning)
    )
    moving = (rates.angular, rates.linear, rates.twist, rates.swing)
    return GeometricJacobian(joints, turning, *(some[indices] for some in moving))


def descendant_matrix(skeleton: Skeleton, rates: GeometricJacobian) -> Float[Array, "J N"]:
    """Compute the matrix that is one where a bone moves with a parameter's joint, else zero."""
    return jnp.asarray(skeleton.descendants[list(rates.joints)].T, rates.linear.dtype)


def project_velocities(
    points: Float[Array, "V 3"], directions: Float[Array, "V R 3"], rates: GeometricJacobian
) -> Float[Array, "V R N"]:
    """Compute `n . (a x p + b)` along directions `n`, as if all points `p` were descendants of all joints.

    With `n . (a x p) = a . (p x n)` it is one product of wrenches and twists.
    """
    return wrenches_of(points, directions) @ jnp.concatenate([rates.angular, rates.linear], 1).T


def composite_equations(
    skeleton: Skeleton,
    rates: GeometricJacobian,
    bones: Int[Array, "P"],
    wrenches: Float[Array, "P R 6"],
    residuals: Float[Array, "P R"],
    weights: Float[Array, "P"],
) -> tuple[Float[Array, "D"], Float[Array, "D D"]]:
    """Compute the gradient `J^T W r` and the matrix `J^T W J` of points that are fixed to bones.

    A joint moves all bones below it by one twist. So a pair of joints on one path shares the sum over the bones below the
    lower one, and other pairs share nothing. This is the composite-rigid-body algorithm (Featherstone 2008, section 6.2) with
    information in place of inertia. It does not form the rows of the whole tangent.

    **Arguments:** `wrenches` of the R rows of each point. A row is their product with the twist `(angular, linear)` of the
    point's bone (`wrenches_of`). `weights` of the points.
    """
    weighted = wrenches * weights[:, None, None]
    information = multiply_small(jnp.swapaxes(weighted, 1, 2), wrenches).reshape(len(bones), 36)
    forces = apply_small(jnp.swapaxes(weighted, 1, 2), residuals)
    joints = list(rates.joints)
    below = (
        jnp.asarray(skeleton.descendants, wrenches.dtype)
        .at[:, bones]
        .get(mode="promise_in_bounds", wrap_negative_indices=False)
    )
    sums = (below @ jnp.concatenate([information, forces], 1))[jnp.asarray(joints)]
    twists = jnp.concatenate([rates.angular, rates.linear], 1)
    pulled = apply_small(sums[:, :36].reshape(-1, 6, 6), twists)
    # entry (i, j) has the bones below the joint of j, right where that joint is below the joint of i
    pairs, lower = twists @ pulled.T, skeleton.descendants[joints][:, joints]
    matrix = jnp.where(lower, pairs, jnp.where(lower.T, pairs.T, 0.0))
    return jnp.sum(twists * sums[:, 36:], 1), matrix


def wrenches_of(points: Float[Array, "P 3"], directions: Float[Array, "P R 3"]) -> Float[Array, "P R 6"]:
    """Compute the wrenches `(p x n, n)` of directions at points; their product with a twist `(a, b)` is `n . (a x p + b)`."""
    return jnp.concatenate([jnp.cross(points[:, None], directions), directions], -1)


def _differentiate_swing_twist(function, directions: Float[Array, "K D"]) -> SwingTwist:
    """Differentiate a function that returns a `SwingTwist` at zero along each direction."""
    still = jnp.zeros_like(directions[0])
    return jax.vmap(lambda direction: jax.jvp(function, (still,), (direction,))[1])(directions)


def _parameter_axes(skeleton: Skeleton) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Find the joint of each parameter of a tangent, the index of its axis, and if it is a rotation."""
    layout = dof_layout(skeleton)
    numbers = np.zeros(skeleton.num_dofs, int)
    turning = np.zeros(skeleton.num_dofs, bool)
    for slots, turns in ((layout.translations, False), (layout.rotations, True)):
        joint, number = np.nonzero(slots < skeleton.num_dofs)
        numbers[slots[joint, number]] = number
        turning[slots[joint, number]] = turns
    return layout.joints, numbers, turning
