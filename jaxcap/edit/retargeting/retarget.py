"""Give one skeleton's motion to another of different proportions and another rest pose.

Every matched bone of the target turns in the world as its source bone does, after a
constant rotation that makes up for the two rest poses (T-pose against A-pose): limbs are
aligned bone by bone, so that they point the same way; the trunk, whose rest is upright in
both, is aligned as a whole, since its bones differ by anatomy and not by pose.
"""

from collections.abc import Mapping
from itertools import pairwise
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...body.kinematics import forward_kinematics, joint_paths, joint_positions
from ...body.pose import Motion, Pose, rest_pose, universal_angles
from ...body.skeleton import Skeleton
from ...geometry import rotation
from ...geometry.axes import nearest_axis, nearest_turn
from ...geometry.procrustes import nearest_rotation
from ..joint_names import GIRDLES, LEGS, match_names, plain_name, sided

#: the vertical where nothing else is said, and the share of frames in which a motion is below its floor
UP, LOWEST = np.array([0.0, 1.0, 0.0]), 0.02


class _Plan(NamedTuple):
    """What does not change over the frames; J is the target's number of joints."""

    #: (J,) the source joint of each target joint, -1 for none
    sources: np.ndarray
    #: (J, 4) rotation from the target's rest to the source's rest, bone by bone
    alignment: np.ndarray
    #: the joints whose mean is carried over: indices into source and target
    anchors: tuple[np.ndarray, np.ndarray]
    #: target metres for one source metre
    ratio: float
    #: (3,) the vertical of the source's world
    up: np.ndarray


def retarget(
    motion: Motion,
    source: Skeleton,
    target: Skeleton,
    names: Mapping[str, str] | None = None,
    *,
    floor: float | None = None,
) -> Motion:
    """The `motion` of `source` as a motion of `target`, in the world of the source.

    Matched limb bones point where the source's point, exactly so where the target's joints
    are ball joints; a revolute or universal joint takes the part that its axes allow. A
    joint without a match stays as it is at rest. The middle of the hips follows that of the
    source, scaled by the ratio of the leg lengths about the floor, so that feet keep to it; without
    matched legs the root does, scaled by the ratio of all matched bones. Heights are along `vertical`.

    **Arguments:** `names` leads from source to target names; where it is not given, equal
    names and the names that ASF, CMU BVH and the embedded human have for one joint match. `floor` is
    how high the floor of the source lies, metres; where it is not given, the lowest joint stands on
    it (`floor_of`), which is some centimetres too high for a body whose soles are below its toes'
    joints: the feet then miss the floor by that times one less the ratio.

    **Raises:** `ValueError` when `names` holds a name that a skeleton does not have, when
    fewer than three joints match, or when the motion has other joints than `source`.
    """
    if motion.poses.rotations.shape[1] != source.num_joints:
        raise ValueError(
            f"The motion moves {motion.poses.rotations.shape[1]} joints and the source skeleton has "
            f"{source.num_joints}; give the skeleton that the motion was read with."
        )
    plan = _plan(source, target, match_names(source.names, target.names, names))
    if floor is None:
        floor = floor_of(joint_paths(source, motion.poses), plan.up)
    dtype = target.centres.dtype
    poses = _retarget_frames(
        source,
        target,
        motion.poses,
        jnp.asarray(plan.sources),
        jnp.asarray(plan.alignment, dtype),
        (jnp.asarray(plan.anchors[0]), jnp.asarray(plan.anchors[1])),
        jnp.asarray(plan.ratio, dtype),
        jnp.asarray((1.0 - plan.ratio) * floor * plan.up, dtype),
    )
    return Motion(poses, motion.rate)


def size_ratio(source: Skeleton, target: Skeleton, names: Mapping[str, str] | None = None) -> float:
    """Metres of the target for one of the source, by which `retarget` scales places: that of the legs,
    or of all matched bones. Raises as `retarget` does."""
    return _plan(source, target, match_names(source.names, target.names, names)).ratio


def vertical(
    source: Skeleton, target: Skeleton, names: Mapping[str, str] | None = None
) -> Float[np.ndarray, "3"]:
    """The direction along which `retarget` scales heights: the coordinate axis from feet to hips of the source at rest,
    whose world the target comes into; y where no matched legs show it. Raises as `retarget` does."""
    return _plan(source, target, match_names(source.names, target.names, names)).up


def floor_of(points: Float[Array | np.ndarray, "F N 3"], up: np.ndarray = UP) -> float:
    """How high along `up` the floor of a motion lies, by the lowest of its points, metres: as high as the lowest
    point of a frame is in a fiftieth of all frames, so that a single frame through the floor does not count."""
    heights = np.asarray(points, float) @ up
    return float(np.quantile(heights.min(axis=1), LOWEST)) if heights.size else 0.0


@eqx.filter_jit
def _retarget_frames(source, target, poses, sources, alignment, anchors, ratio, lift) -> Pose:
    def frame(pose: Pose) -> Pose:
        return _retarget_frame(source, target, pose, sources, alignment, anchors, ratio, lift)

    return jax.vmap(frame)(poses)


def _retarget_frame(source, target, pose, sources, alignment, anchors, ratio, lift) -> Pose:
    moved = forward_kinematics(source, pose)
    whole = rotation.from_matrix(moved.rotations / pose.scale)
    wanted = rotation.multiply(whole[jnp.maximum(sources, 0)], alignment)
    rotations = _local_rotations(target, wanted, sources >= 0)
    still = Pose(jnp.zeros_like(target.centres), rotations, jnp.ones((), rotations.dtype))
    reached = joint_positions(target, forward_kinematics(target, still))
    anchor = ratio * jnp.mean(joint_positions(source, moved)[anchors[0]], 0) + lift
    shift = anchor - jnp.mean(reached[anchors[1]], 0)
    return Pose(still.translations.at[0].set(shift), rotations, still.scale)


def _local_rotations(target: Skeleton, wanted: Float[Array, "J 4"], matched: Array) -> Float[Array, "J 4"]:
    """Local rotations by which each matched bone stands in the world as `wanted`, from the
    root down, so that what one joint cannot do the next one makes good."""
    identity = rotation.identity(wanted.dtype)
    local = jnp.tile(identity, (target.num_joints, 1))
    whole = local
    parents = np.array(target.parents)
    for level in target.levels:
        joints = np.array(level)
        above = jnp.where(parents[joints, None] < 0, identity, whole[np.maximum(parents[joints], 0)])
        turn = rotation.normalise(rotation.multiply(rotation.conjugate(above), wanted[joints]))
        turn = _allowed(target, joints, jnp.where(matched[joints, None], turn, identity))
        local = local.at[joints].set(turn)
        whole = whole.at[joints].set(rotation.multiply(above, turn))
    return local


def _allowed(skeleton: Skeleton, joints: np.ndarray, turn: Float[Array, "N 4"]) -> Float[Array, "N 4"]:
    """The part of the rotations of some `joints` that their kinds can do."""
    kinds = np.array(skeleton.kinds)[joints, None]
    first, second = skeleton.axes[joints, 0], skeleton.axes[joints, 1]
    if "revolute" in kinds:
        turn = jnp.where(kinds == "revolute", rotation.swing_twist(turn, first)[1], turn)
    if "universal" in kinds:
        none = rest_pose(skeleton)
        angles = universal_angles(
            skeleton, Pose(none.translations, none.rotations.at[joints].set(turn), none.scale)
        )
        turns = [rotation.about_axis(axis, angles[joints, i]) for i, axis in enumerate((first, second))]
        turn = jnp.where(kinds == "universal", rotation.multiply(*turns), turn)
    turns_at_all = np.isin(kinds, ["ball", "free", "revolute", "universal"])
    return jnp.where(turns_at_all, turn, rotation.identity(turn.dtype))


def _plan(source: Skeleton, target: Skeleton, matches: dict[int, int]) -> _Plan:
    """`matches` leads from target to source joints."""
    source_centres, target_centres = np.asarray(source.centres, float), np.asarray(target.centres, float)
    joints = np.array(sorted(matches))
    sources = np.full(target.num_joints, -1)
    sources[joints] = [matches[joint] for joint in joints]
    upright = _upright(target_centres[joints], source_centres[sources[joints]])
    follows, source_descent = _follows(target, source, matches), source.descent
    has_side, plain = sided(target.names), [plain_name(name) for name in target.names]

    alignment = np.tile(_quaternion(upright), (target.num_joints, 1))
    for joint in joints:
        parent = target.parents[joint]
        if not has_side[joint]:
            continue
        if parent >= 0:
            alignment[joint] = alignment[parent]
        child = follows.get(int(joint))
        if child is None or plain[joint] in GIRDLES or not source_descent[sources[joint], sources[child]]:
            continue
        here = target_centres[child] - target_centres[joint]
        there = source_centres[sources[child]] - source_centres[sources[joint]]
        lengths = np.linalg.norm(here), np.linalg.norm(there)
        if min(lengths) > 1e-6:
            # from where the parent's alignment leaves it, so that no twist comes in between
            carried = rotation.rotate(jnp.asarray(alignment[joint]), jnp.asarray(here / lengths[0]))
            arc = rotation.shortest_arc(carried, jnp.asarray(there / lengths[1]))
            alignment[joint] = rotation.multiply(arc, jnp.asarray(alignment[joint]))
            twist = _hinge_twist(source, target, sources, follows, int(joint), alignment[joint])
            alignment[joint] = rotation.multiply(
                rotation.about_axis(jnp.asarray(there / lengths[1]), jnp.asarray(twist)),
                jnp.asarray(alignment[joint]),
            )

    legs = [[plain.index(name) for name in leg] for leg in LEGS if set(leg) <= set(plain)]
    legs = [leg for leg in legs if set(leg) <= set(matches)]
    bones = [pair for leg in legs for pair in pairwise(leg)] or list(follows.items())
    first, last = np.array(bones).reshape(-1, 2).T
    here = np.linalg.norm(target_centres[last] - target_centres[first], axis=-1).sum()
    there = np.linalg.norm(source_centres[sources[last]] - source_centres[sources[first]], axis=-1).sum()
    anchors = np.array([leg[0] for leg in legs] or [joints[0]])
    ratio = float(here / there) if there > 0 else 1.0
    return _Plan(sources, alignment, (sources[anchors], anchors), ratio, _up(source_centres, sources, legs))


def _up(centres: np.ndarray, sources: np.ndarray, legs: list[list[int]]) -> np.ndarray:
    """(3,) the coordinate axis from the feet to the hips at rest; y without legs."""
    if not legs:
        return UP
    thighs, _, feet = sources[np.array(legs)].T
    return nearest_axis((centres[thighs] - centres[feet]).mean(0))


def _hinge_twist(source, target, sources, follows, joint: int, alignment: np.ndarray) -> float:
    """Radians about the source's bone by which the aligned bone must turn so that the hinge at
    its far end turns about the source's axis. Without it an elbow bent at rest would bend
    sideways. Zero where the source has no hinge, or the target's rest does not show one."""
    child = follows[joint]
    grandchild = follows.get(child)
    if grandchild is None or source.kinds[sources[child]] != "revolute":
        return 0.0
    centres = np.asarray(target.centres, float)
    bend = np.cross(centres[child] - centres[joint], centres[grandchild] - centres[child])
    reach = np.linalg.norm(centres[child] - centres[joint]) * np.linalg.norm(
        centres[grandchild] - centres[child]
    )
    if np.linalg.norm(bend) < 0.1 * reach:
        return 0.0
    bone = np.asarray(source.centres[sources[child]] - source.centres[sources[joint]], float)
    bone = bone / np.linalg.norm(bone)
    here = np.asarray(rotation.rotate(jnp.asarray(alignment), jnp.asarray(bend)))
    there = np.asarray(source.axes[sources[child], 0], float)
    # the sign of a hinge's axis means nothing: take the nearer of the two
    there = there if here @ there > 0 else -there
    here, there = (v - (v @ bone) * bone for v in (here, there))
    return float(np.arctan2(bone @ np.cross(here, there), here @ there))


def _follows(target: Skeleton, source: Skeleton, matches: dict[int, int]) -> dict[int, int]:
    """The next matched joint along the longest chain of matched joints below each one."""
    chain = dict.fromkeys(matches, 0)
    follows: dict[int, int] = {}
    for joint in sorted(matches, reverse=True):
        above = target.parents[joint]
        while above >= 0 and above not in matches:
            above = target.parents[above]
        if above >= 0 and chain[joint] + 1 >= chain[above]:
            chain[above], follows[above] = chain[joint] + 1, joint
    return follows


def _upright(target: np.ndarray, source: np.ndarray) -> np.ndarray:
    """(3, 3) rotation from the target's rest to the source's as they stand, whatever the arms
    do: the best fit of the joints (Kabsch), put onto the nearest turn of the coordinate axes,
    because a person at rest stands along them; the fit itself where none is near."""
    fit = nearest_rotation((source - source.mean(0)).T @ (target - target.mean(0)))
    snapped = nearest_turn(fit)
    near = np.trace(snapped.T @ fit) > 1 + 2 * np.cos(np.radians(30.0)) and np.linalg.det(snapped) > 0
    return snapped if near else fit


def _quaternion(matrix: np.ndarray) -> np.ndarray:
    return np.asarray(rotation.from_matrix(jnp.asarray(matrix)))
