"""Exchange of joints: redundant bones are removed, and bones that bend are split.

Learning begins with rigid parts, and soft regions then have some parts of their own. Once weights blend,
these are redundant, while small parts that move independently are still merged with their neighbours. The
residual identifies both: a bone with no residual gains nothing by a split, and a bone that is a blend of the
bones around loses nothing by removal.
"""

from collections.abc import Callable, Sequence

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ...body.body import Body, posed_vertices
from ...body.pose import Pose
from ..state import LearnState
from ..symmetry.surface_symmetry import SurfaceSymmetry
from .insert_and_remove import EditedBody, Removal, Split, insert_joint, remove_joint
from .insertion_candidates import find_splits
from .removal_candidates import find_removals
from .symmetric_edits import count_unpaired, group_removals, group_splits, make_edit_symmetric, mirror_groups

#: the share of a removal's cost that remains after all else has adapted
LASTING_COST_SHARE = 0.1
#: the least gain predicted for a split, and the least decrease kept from an exchange, as shares of the error
MIN_PREDICTED_GAIN, MIN_DECREASE = 0.01, 0.005
#: with a free number of joints: the least gain of each further joint, as a share of Q; the largest cost of a
#: removed joint with vertices of its own or without, as shares of the error
MIN_GAIN_PER_JOINT, MAX_IDLE_COST, MAX_BARE_COST = 0.02, 0.02, 0.04
#: the largest share of joints that are exchanged at once
AT_ONCE = 0.2


def exchange_joints(
    state: LearnState,
    targets: Float[Array, "F V 3"],
    improve: Callable[[LearnState, EditedBody], LearnState],
    step: str = "exchange",
    tries: int = 3,
    variable_count: bool = False,
    symmetry: SurfaceSymmetry | None = None,
) -> LearnState:
    """Exchange joints as long as Q falls.

    The joints with the largest predicted gain are inserted, and as many with the least cost are removed. The
    result is improved, and kept if Q falls by more than a share `MIN_DECREASE`; otherwise fewer joints are exchanged.
    If the number is `variable_count`, only joints with a small cost are removed, and each additional joint must gain
    `MIN_GAIN_PER_JOINT`; finally, joints without which Q does not rise are removed. The history gets one entry of Q for
    each trial, named `step`, and one if no trial is worthwhile.

    **Arguments:** `targets` are the meshes of the state's body; `improve` replaces the body of the state by
    an edited one and improves it by a few rounds; `tries` is the most trials. With a `symmetry` of the surface, joints are
    inserted and removed in pairs or on the middle, and all pairs are found again after each edit; one that leaves further joints
    without a partner is not made.

    Only trees of "ball" joints below one "free" root are changed; others are returned unchanged.
    """
    begun, most, groups = len(state.history), None, None
    for _ in range(tries if has_exchangeable_joints(state.body) else 0):
        groups = (
            select_splits(state.body, state.motion.poses, targets, symmetry) if groups is None else groups
        )
        groups = groups if most is None else groups[:most]
        if not groups:
            break
        before = state.history[-1][1]
        made, splits = _insert_groups(state, groups, symmetry)
        if not splits:
            break
        trial = state
        if variable_count:
            # after improvement, idle new bones can be recognised
            trial = improve(state, made)
            made = EditedBody(trial.body, trial.motion.poses, trial.left_right_pairs)
        pairs = None if symmetry is None else made.left_right_pairs
        removals = select_removals(made.body, made.poses, targets, len(splits), variable_count, pairs)
        more = len(splits) - len(removals)
        if removals and (variable_count or more == 0):
            less = _symmetric(remove_joints(*made, removals), symmetry)
            if _keeps_pairs(made, less, symmetry):
                trial = improve(trial, less)
            else:
                more = len(splits)
        after = trial.history[-1][1]
        if (variable_count or more == 0) and after < (
            1 - MIN_DECREASE - MIN_GAIN_PER_JOINT * max(more, 0)
        ) * before:
            state, most, groups = trial._replace(history=(*state.history, (step, after))), None, None
        else:
            state, most = state._replace(history=(*state.history, (step, before))), len(groups) // 3
    if variable_count and has_exchangeable_joints(state.body):
        state = _remove_redundant_joints(state, targets, improve, step, symmetry)
    if len(state.history) == begun:
        state = state._replace(history=(*state.history, (step, state.history[-1][1])))
    return state


def _remove_redundant_joints(
    state: LearnState,
    targets: Float[Array, "F V 3"],
    improve: Callable[[LearnState, EditedBody], LearnState],
    step: str,
    symmetry: SurfaceSymmetry | None,
) -> LearnState:
    """Remove joints without which Q does not rise after all else has adapted."""
    body, poses, before = state.body, state.motion.poses, state.history[-1][1]
    count = max(1 if symmetry is None else 2, round(AT_ONCE / 2 * body.skeleton.num_joints))
    pairs = None if symmetry is None else state.left_right_pairs
    removals = select_removals(body, poses, targets, count, False, pairs)
    if not removals:
        return state
    before_removal = EditedBody(body, poses, state.left_right_pairs)
    made = _symmetric(remove_joints(*before_removal, removals), symmetry)
    if not _keeps_pairs(before_removal, made, symmetry):
        return state
    trial = improve(state, made)
    after = trial.history[-1][1]
    history = (*state.history, (step, min(after, before)))
    return (trial if after <= before else state)._replace(history=history)


def has_exchangeable_joints(body: Body) -> bool:
    """Test whether a tree can be changed: "ball" joints below one "free" root."""
    kinds, parents = body.skeleton.kinds, body.skeleton.parents
    return kinds[0] == "free" and set(kinds[1:]) <= {"ball"} and parents.count(-1) == 1


def _symmetric(made: EditedBody, symmetry: SurfaceSymmetry | None) -> EditedBody:
    """Make an edited body symmetric, if its surface is."""
    return made if symmetry is None else make_edit_symmetric(made, symmetry)


def _insert_groups(
    state: LearnState, groups: Sequence[tuple[Split, ...]], symmetry: SurfaceSymmetry | None
) -> tuple[EditedBody, list[Split]]:
    """Insert groups of splits, without the last ones as long as these leave joints without a partner."""
    old = EditedBody(state.body, state.motion.poses, state.left_right_pairs)
    for number in range(len(groups), 0, -1):
        splits = [split for group in groups[:number] for split in group]
        made = _symmetric(insert_joints(*old, splits), symmetry)
        if _keeps_pairs(old, made, symmetry):
            return made, splits
    return old, []


def _keeps_pairs(old: EditedBody, new: EditedBody, symmetry: SurfaceSymmetry | None) -> bool:
    """Test whether an edit leaves no further joint without a partner off the middle."""
    return symmetry is None or count_unpaired(new.body, symmetry) <= count_unpaired(old.body, symmetry)


def select_splits(
    body: Body, poses: Pose, targets: Float[Array, "F V 3"], symmetry: SurfaceSymmetry | None = None
) -> list[tuple[Split, ...]]:
    """Select the groups of splits of largest gain that share no joint: pairs and single ones.

    As many are taken as gain more than the expected cost of as many removals.
    """
    least = MIN_PREDICTED_GAIN * float(jnp.sum((targets - posed_vertices(body, poses)) ** 2))
    most = max(1, round(AT_ONCE * body.skeleton.num_joints))
    groups, taken, count = [], set(), 0
    found = find_splits(body, poses, targets, None if symmetry is None else symmetry.mirrored)
    candidates = group_splits(found, symmetry)
    candidates = candidates if symmetry is None else mirror_groups(candidates, body, poses, symmetry)
    for group in candidates:
        moved = set().union(*(_moved(split) for split in group))
        fits = not groups or count + len(group) <= most
        if sum(split.gain for split in group) > least * len(group) and not taken & moved and fits:
            groups.append(group)
            taken |= moved
            count += len(group)
    costs = np.cumsum([0.0, *(removal.cost for removal in find_removals(body, poses, targets))])
    gains = np.cumsum([sum(split.gain for split in group) for group in groups])
    sizes = np.cumsum([len(group) for group in groups], dtype=int)
    pays = (sizes < len(costs)) & (gains > LASTING_COST_SHARE * costs[np.minimum(sizes, len(costs) - 1)])
    return groups[: np.flatnonzero(pays).max() + 1] if pays.any() else []


def select_removals(
    body: Body,
    poses: Pose,
    targets: Float[Array, "F V 3"],
    count: int,
    only_idle: bool,
    pairs: Int[np.ndarray, "P 2"] | None = None,
) -> list[Removal]:
    """Select up to `count` removals of least cost, with no joint the parent of another.

    With `only_idle`, only removals of small cost are selected. Both joints of one of the `pairs` are removed, or none.
    """
    error = float(jnp.sum((targets - posed_vertices(body, poses)) ** 2))
    parents = body.skeleton.parents
    counts = np.bincount(np.asarray(body.skin.dominant_bones()), minlength=len(parents))
    chosen: list[Removal] = []

    def is_allowed(removal: Removal) -> bool:
        near = {parents[other.joint] for other in chosen} | {
            child for other in chosen for child, parent in enumerate(parents) if parent == other.joint
        }
        share = MAX_IDLE_COST if counts[removal.joint] else MAX_BARE_COST
        return removal.joint not in near and (not only_idle or removal.cost < error * share)

    for group in group_removals(find_removals(body, poses, targets), pairs):
        if len(chosen) + len(group) <= count and all(is_allowed(removal) for removal in group):
            chosen += group
    return chosen


def insert_joints(
    body: Body, poses: Pose, pairs: Int[np.ndarray, "P 2"], splits: Sequence[Split]
) -> EditedBody:
    """Insert the joints of splits that share no joint."""
    names, made = list(body.skeleton.names), EditedBody(body, poses, pairs)
    for split in splits:
        skeleton = made.body.skeleton
        place = [skeleton.index(name) for name in names] + [skeleton.num_joints]
        shares = np.zeros((len(split.weights), skeleton.num_joints + 1))
        shares[:, place] = split.weights
        hung = tuple((place[joint], place[parent], centre) for joint, parent, centre in split.reparented)
        made = insert_joint(*made, split._replace(joint=place[split.joint], weights=shares, reparented=hung))
    return made


def remove_joints(
    body: Body, poses: Pose, pairs: Int[np.ndarray, "P 2"], removals: Sequence[Removal]
) -> EditedBody:
    """Remove joints, none of which is the parent of another."""
    old, made, removed = body.skeleton, EditedBody(body, poses, pairs), []
    for removal in removals:
        shares = np.array(removal.weights)
        # weights of removed bones go to their parents
        for joint in removed:
            shares[:, old.parents[joint]] += shares[:, joint]
        skeleton = made.body.skeleton
        columns = [old.index(name) for name in skeleton.names]
        renumbered = removal._replace(
            joint=skeleton.index(old.names[removal.joint]), weights=shares[:, columns]
        )
        made = remove_joint(*made, renumbered)
        removed.append(removal.joint)
    return made


def _moved(split: Split) -> set[int]:
    """Return the joints with a new parent in a split, and their parents, without the new joint."""
    ends = {split.joint, *(end for joint, parent, _ in split.reparented for end in (joint, parent))}
    return ends - {split.weights.shape[1] - 1}
