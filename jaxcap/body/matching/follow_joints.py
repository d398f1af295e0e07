"""Poses of a skeleton whose joints follow those of another one, as planned by `plan_retarget`."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...geometry import rotation
from ..kinematics import forward_kinematics, joint_positions
from ..pose import Pose, rest_pose, universal_angles
from ..skeleton import Skeleton
from .plan import RetargetPlan


def follow_joints(
    target: Skeleton,
    plan: RetargetPlan,
    rotations: Float[np.ndarray, "F S 4"],
    anchors: Float[np.ndarray, "F 3"],
) -> Pose:
    """Make the poses in which the bones of a target have the rotations of the source's bones, F frames.

    **Arguments:** `rotations`, the world rotations of the source's joints from rest; `anchors`, the mean position of the target's
    anchor joints, metres.
    """
    dtype = target.centres.dtype
    since = _multiply_quaternions(rotations, plan.reference * np.array([1.0, -1.0, -1.0, -1.0]))
    first, second = (since[:, np.maximum(plan.sources[:, end], 0)] for end in (0, 1))
    return _follow_frames(
        target,
        jnp.asarray(first, dtype),
        jnp.asarray(second, dtype),
        jnp.asarray(plan.shares, dtype),
        jnp.asarray(plan.alignment, dtype),
        jnp.asarray(plan.sources[:, 0] >= 0),
        jnp.asarray(anchors, dtype),
        jnp.asarray(plan.anchors[1]),
    )


def _multiply_quaternions(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    aw, av, bw, bv = a[..., :1], a[..., 1:], b[..., :1], b[..., 1:]
    w = aw * bw - np.sum(av * bv, -1, keepdims=True)
    return np.concatenate([w, aw * bv + bw * av + np.cross(av, bv)], -1)


@eqx.filter_jit
def _follow_frames(target, first, second, shares, alignment, matched, anchors, anchor_joints) -> Pose:
    def frame(first, second, anchor):
        return _follow_frame(target, first, second, shares, alignment, matched, anchor, anchor_joints)

    return jax.vmap(frame)(first, second, anchors)


def _follow_frame(target, first, second, shares, alignment, matched, anchor, anchor_joints) -> Pose:
    wanted = rotation.multiply(rotation.slerp(first, second, shares), alignment)
    rotations = _local_rotations(target, wanted, matched)
    still = Pose(jnp.zeros_like(target.centres), rotations, jnp.ones((), rotations.dtype))
    reached = joint_positions(target, forward_kinematics(target, still))
    shift = anchor - jnp.mean(reached[anchor_joints], 0)
    return Pose(still.translations.at[0].set(shift), rotations, still.scale)


def _local_rotations(
    target: Skeleton, world_rotations: Float[Array, "J 4"], matched: Array
) -> Float[Array, "J 4"]:
    """Compute local rotations that give each matched bone its `world_rotations` world rotation.

    They are computed from the root down, so that each joint compensates for the restrictions of those above
    it.
    """
    identity = rotation.identity(world_rotations.dtype)
    local = jnp.tile(identity, (target.num_joints, 1))
    whole = local
    parents = np.array(target.parents)
    for level in target.levels:
        joints = np.array(level)
        above = jnp.where(parents[joints, None] < 0, identity, whole[np.maximum(parents[joints], 0)])
        turn = rotation.normalise(rotation.multiply(rotation.conjugate(above), world_rotations[joints]))
        turn = _project_to_kinds(target, joints, jnp.where(matched[joints, None], turn, identity))
        local = local.at[joints].set(turn)
        whole = whole.at[joints].set(rotation.multiply(above, turn))
    return local


def _project_to_kinds(
    skeleton: Skeleton, joints: np.ndarray, rotations: Float[Array, "N 4"]
) -> Float[Array, "N 4"]:
    """Project the rotations of some `joints` onto those that their kinds allow."""
    kinds = np.array(skeleton.kinds)[joints, None]
    first, second = skeleton.axes[joints, 0], skeleton.axes[joints, 1]
    if "revolute" in kinds:
        rotations = jnp.where(kinds == "revolute", rotation.swing_twist(rotations, first)[1], rotations)
    if "universal" in kinds:
        none = rest_pose(skeleton)
        angles = universal_angles(
            skeleton, Pose(none.translations, none.rotations.at[joints].set(rotations), none.scale)
        )
        turns = [rotation.about_axis(axis, angles[joints, i]) for i, axis in enumerate((first, second))]
        rotations = jnp.where(kinds == "universal", rotation.multiply(*turns), rotations)
    turns_at_all = np.isin(kinds, ["ball", "free", "revolute", "universal"])
    return jnp.where(turns_at_all, rotations, rotation.identity(rotations.dtype))
