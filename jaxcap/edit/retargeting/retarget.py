"""Retarget motions to skeletons of other proportions, rest poses and names."""

import warnings
from collections.abc import Mapping

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...arguments import checked
from ...body.kinematics import forward_kinematics, joint_positions
from ...body.pose import Motion, Pose, rest_pose, universal_angles
from ...body.skeleton import Skeleton
from ...geometry import rotation
from ..matching.upright_pose import joint_transforms
from .plan import UP, RetargetPlan, plan_retarget

#: share of frames in which a motion may be below its floor
FLOOR_QUANTILE = 0.02


@checked
def retarget(
    motion: Motion,
    source: Skeleton,
    target: Skeleton,
    names: Mapping[str, str | None] | None = None,
    *,
    floor: float | None = None,
    plan: RetargetPlan | None = None,
) -> Motion:
    """Retarget the `motion` of `source` to `target`, in the world of the source.

    Joints match by their names in many programs and by the tree (`match_joints`, which also describes the
    treatment of joints without a match). Limb bones have the directions of the source's, exactly if the
    target's joints are ball joints; a revolute or universal joint takes the part that its axes allow. The
    rotation of a source joint without a match is composed onto the next joints below it. A target joint
    without one keeps its rest pose, except for spine and neck, which share rotations if one skeleton has more
    joints there. The middle of the hips follows that of the source, scaled by the ratio of the leg lengths
    about the floor, so that feet stay on it. Without matched legs the root does, scaled by the ratio of all
    matched bones. Heights are along `up_axis`.

    **Arguments:** `names` maps joints of the source to those of the target, or to None for a joint that has
    no match, and overrides names and trees. `floor` is the height of the source's floor, metres. If it is not
    given, it is estimated from the lowest joints (`floor_height`), which is some centimetres too high for a body
    whose soles are below its toe joints. The feet then miss the floor by that times one minus the ratio.
    `plan` is the result of `plan_retarget` for this motion, if it is known already; `names` is then ignored,
    and the caller has to report the warnings of its matches.

    **Warns:** `UserWarning` if one arm or one leg has no match, or a table exchanges left and right.

    **Raises:** `UnmatchedJoints`, a `ValueError`, if both arms or both legs have no match or left and right
    cannot be determined. `ValueError` for a name that a skeleton does not have, if fewer than three joints
    match, if the person stands neither at rest nor in the motion, or if the motion has other joints than
    `source`.
    """
    if motion.poses.rotations.shape[1] != source.num_joints:
        raise ValueError(
            f"The motion has {motion.poses.rotations.shape[1]} joints, but the source skeleton has "
            f"{source.num_joints}; give the skeleton of the motion."
        )
    if plan is None:
        plan = plan_retarget(source, target, names, motion)
        for sentence in plan.matches.warnings:
            warnings.warn(f"{sentence[0].upper()}{sentence[1:]}.", stacklevel=2)
    # source data stay in NumPy, so that one target compiles once for all sources
    positions, turns = joint_transforms(source, motion.poses)
    if floor is None:
        floor = floor_height(positions, plan.up)
    dtype = target.centres.dtype
    since = _multiply_quaternions(turns, plan.reference * np.array([1.0, -1.0, -1.0, -1.0]))
    first, second = (since[:, np.maximum(plan.sources[:, end], 0)] for end in (0, 1))
    lift = (1.0 - plan.ratio) * floor * plan.up
    poses = _retarget_frames(
        target,
        jnp.asarray(first, dtype),
        jnp.asarray(second, dtype),
        jnp.asarray(plan.shares, dtype),
        jnp.asarray(plan.alignment, dtype),
        jnp.asarray(plan.sources[:, 0] >= 0),
        jnp.asarray(plan.ratio * positions[:, plan.anchors[0]].mean(1) + lift, dtype),
        jnp.asarray(plan.anchors[1]),
    )
    return Motion(poses, motion.rate)


@checked
def size_ratio(
    source: Skeleton,
    target: Skeleton,
    names: Mapping[str, str | None] | None = None,
    motion: Motion | None = None,
) -> float:
    """Compute the size ratio of target to source by which `retarget` scales positions.

    It is the ratio of the lengths of the legs, or of all matched bones. Raises as `retarget` does.
    """
    return plan_retarget(source, target, names, motion).ratio


@checked
def up_axis(
    source: Skeleton,
    target: Skeleton,
    names: Mapping[str, str | None] | None = None,
    motion: Motion | None = None,
) -> Float[np.ndarray, "3"]:
    """Find the direction along which `retarget` scales heights.

    It is the coordinate axis from feet to hips of the standing source, in whose world the target moves; y if
    no matched legs determine it. Raises as `retarget` does.
    """
    return plan_retarget(source, target, names, motion).up


@checked
def floor_height(points: Float[Array | np.ndarray, "F N 3"], up: np.ndarray = UP) -> float:
    """Estimate the height of a motion's floor along `up` from its lowest points, metres.

    It is the 2 % quantile of the lowest heights of all frames, so that a single frame below the floor does
    not count.
    """
    heights = np.asarray(points, float) @ up
    return float(np.quantile(heights.min(axis=1), FLOOR_QUANTILE)) if heights.size else 0.0


def _multiply_quaternions(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    aw, av, bw, bv = a[..., :1], a[..., 1:], b[..., :1], b[..., 1:]
    w = aw * bw - np.sum(av * bv, -1, keepdims=True)
    return np.concatenate([w, aw * bv + bw * av + np.cross(av, bv)], -1)


@eqx.filter_jit
def _retarget_frames(target, first, second, shares, alignment, matched, anchors, anchor_joints) -> Pose:
    def frame(first, second, anchor):
        return _retarget_frame(target, first, second, shares, alignment, matched, anchor, anchor_joints)

    return jax.vmap(frame)(first, second, anchors)


def _retarget_frame(target, first, second, shares, alignment, matched, anchor, anchor_joints) -> Pose:
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
