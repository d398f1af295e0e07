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
from .insert_and_remove import EditedBody, Removal, Split, insert_joint, remove_joint
from .insertion_candidates import find_splits
from .removal_candidates import find_removals

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
) -> LearnState:
    """Exchange joints as long as Q falls.

    The joints with the largest predicted gain are inserted, and as many with the least cost are removed. The
    result is improved, and kept if Q falls by more than a share `MIN_DECREASE`; otherwise fewer joints are exchanged.
    If the number is `variable_count`, only joints with a small cost are removed, and each additional joint must gain
    `MIN_GAIN_PER_JOINT`; finally, joints without which Q does not rise are removed. The history gets one entry of Q for
    each trial, named `step`, and one if no trial is worthwhile.

    **Arguments:** `targets` are the meshes of the state's body; `improve` replaces the body of the state by
    an edited one and improves it by a few rounds; `tries` is the most trials.

    Only trees of "ball" joints below one "free" root are changed; others are returned unchanged.
    """
    begun, most, splits = len(state.history), None, None
    for _ in range(tries if has_exchangeable_joints(state.body) else 0):
        splits = select_splits(state.body, state.motion.poses, targets) if splits is None else splits
        splits = splits if most is None else splits[:most]
        if not splits:
            break
        before = state.history[-1][1]
        made, trial = insert_joints(state.body, state.motion.poses, state.left_right_pairs, splits), state
        if variable_count:
            # after improvement, idle new bones can be recognised
            trial = improve(state, made)
            made = EditedBody(trial.body, trial.motion.poses, trial.left_right_pairs)
        removals = select_removals(made.body, made.poses, targets, len(splits), variable_count)
        more = len(splits) - len(removals)
        if removals and (variable_count or more == 0):
            trial = improve(trial, remove_joints(*made, removals))
        after = trial.history[-1][1]
        if (variable_count or more == 0) and after < (
            1 - MIN_DECREASE - MIN_GAIN_PER_JOINT * max(more, 0)
        ) * before:
            state, most, splits = trial._replace(history=(*state.history, (step, after))), None, None
        else:
            state, most = state._replace(history=(*state.history, (step, before))), len(splits) // 3
    if variable_count and has_exchangeable_joints(state.body):
        state = _remove_redundant_joints(state, targets, improve, step)
    if len(state.history) == begun:
        state = state._replace(history=(*state.history, (step, state.history[-1][1])))
    return state


def _remove_redundant_joints(
    state: LearnState,
    targets: Float[Array, "F V 3"],
    improve: Callable[[LearnState, EditedBody], LearnState],
    step: str,
) -> LearnState:
    """Remove joints without which Q does not rise after all else has adapted."""
    body, poses, before = state.body, state.motion.poses, state.history[-1][1]
    count = max(1, round(AT_ONCE / 2 * body.skeleton.num_joints))
    removals = select_removals(body, poses, targets, count, only_idle=False)
    if not removals:
        return state
    trial = improve(state, remove_joints(body, poses, state.left_right_pairs, removals))
    after = trial.history[-1][1]
    history = (*state.history, (step, min(after, before)))
    return (trial if after <= before else state)._replace(history=history)


def has_exchangeable_joints(body: Body) -> bool:
    """Test whether a tree can be changed: "ball" joints below one "free" root."""
    kinds, parents = body.skeleton.kinds, body.skeleton.parents
    return kinds[0] == "free" and set(kinds[1:]) <= {"ball"} and parents.count(-1) == 1


def select_splits(body: Body, poses: Pose, targets: Float[Array, "F V 3"]) -> list[Split]:
    """Select the splits of largest gain that share no joint.

    As many are taken as gain more than the expected cost of as many removals.
    """
    least = MIN_PREDICTED_GAIN * float(jnp.sum((targets - posed_vertices(body, poses)) ** 2))
    splits, taken = [], set()
    for split in find_splits(body, poses, targets):
        if split.gain > least and not taken & _moved(split):
            splits.append(split)
            taken |= _moved(split)
    splits = splits[: max(1, round(AT_ONCE * body.skeleton.num_joints))]
    costs = np.cumsum([removal.cost for removal in find_removals(body, poses, targets)])
    gains = np.cumsum([split.gain for split in splits])
    number = min(len(costs), len(gains))
    paying = np.flatnonzero(gains[:number] > LASTING_COST_SHARE * costs[:number])
    return splits[: paying.max() + 1] if len(paying) else []


def select_removals(
    body: Body, poses: Pose, targets: Float[Array, "F V 3"], count: int, only_idle: bool
) -> list[Removal]:
    """Select up to `count` removals of least cost, with no joint the parent of another.

    With `only_idle`, only removals of small cost are selected.
    """
    error = float(jnp.sum((targets - posed_vertices(body, poses)) ** 2))
    parents = body.skeleton.parents
    counts = np.bincount(np.asarray(body.skin.dominant_bones()), minlength=len(parents))
    chosen: list[Removal] = []
    for removal in find_removals(body, poses, targets):
        neighbours = {parents[other.joint] for other in chosen} | {
            child for other in chosen for child, parent in enumerate(parents) if parent == other.joint
        }
        allowed = (
            np.inf if not only_idle else error * (MAX_IDLE_COST if counts[removal.joint] else MAX_BARE_COST)
        )
        if len(chosen) < count and removal.joint not in neighbours and removal.cost < allowed:
            chosen.append(removal)
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
