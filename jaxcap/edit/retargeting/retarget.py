"""Retarget motions to skeletons of other proportions, rest poses and names."""

import warnings
from collections.abc import Mapping

import numpy as np
from jaxtyping import Array, Float

from ...arguments import checked
from ...body.matching.follow_joints import follow_joints
from ...body.matching.plan import UP, RetargetPlan, plan_retarget
from ...body.matching.upright_pose import joint_transforms
from ...body.pose import Motion
from ...body.skeleton import Skeleton

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
    lift = (1.0 - plan.ratio) * floor * plan.up
    anchors = plan.ratio * positions[:, plan.anchors[0]].mean(1) + lift
    return Motion(follow_joints(target, plan, turns, anchors), motion.rate)


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
