"""Joints exchanged: one dissolved where two do the work of one, one made where a bone bends.

Parts that move rigidly are where learning starts, and soft regions have some of their own there.
Once weights blend, those are left over, while small parts that do move by themselves are still
in one with their neighbours. The residual tells which: of a bone whose vertices all go where they
should, nothing is gained by a split; and of a bone that is a blend of those around it, nothing is
lost.
"""

from collections.abc import Callable, Sequence

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ...body.body import Body, deform_all
from ...body.pose import Pose
from ..state import LearnState
from .joint_insertion import find_splits
from .joint_removal import find_removals
from .skeleton_edit import Graft, Removal, Split, with_joint, without_joint

#: the share of a removal's cost that is left when all else has adapted to it
LASTING = 0.1
#: what a split has to promise, and what an exchange has to keep, as shares of the error
PROMISE, KEEP = 0.01, 0.005
#: where the number of joints is free: what each further one has to gain, as a share of Q; and what one
#: may cost that goes, with vertices of its own or without, as shares of the error
WORTH, IDLE, BARE = 0.02, 0.02, 0.04
#: the share of all joints that are exchanged at once, at most
AT_ONCE = 0.2


def exchange(
    state: LearnState,
    targets: Float[Array, "F V 3"],
    improve: Callable[[LearnState, Graft], LearnState],
    step: str = "exchange",
    tries: int = 3,
    free: bool = False,
) -> LearnState:
    """Exchange joints as long as Q falls.

    The body grows the joints that promise most and loses as many, those that are missed least. What
    comes out is improved, and kept where Q is lower than before by more than a share `KEEP`; where it
    is not, fewer are exchanged. Where the number is `free`, only those go that are hardly missed, and
    each joint more has to be `WORTH` it; at last, joints go without which Q is no higher. The history
    gets one entry of Q for each trial, named `step`; one, too, where nothing is worth a trial.

    **Arguments:** `targets` the meshes of the state's body; `improve` puts a grafted body in the
    place of the state's and makes it better by a few rounds; `tries` at most.

    Only trees of "ball" joints under one "free" root are changed; others are given back as they are.
    """
    begun, most, splits = len(state.history), None, None
    for _ in range(tries if exchangeable(state.body) else 0):
        splits = worthwhile(state.body, state.motion.poses, targets) if splits is None else splits
        splits = splits if most is None else splits[:most]
        if not splits:
            break
        before = state.history[-1][1]
        made, trial = grown(state.body, state.motion.poses, state.pairs, splits), state
        if free:
            # what grew shows by then whether it is idle
            trial = improve(state, made)
            made = Graft(trial.body, trial.motion.poses, trial.pairs)
        removals = spare(made.body, made.poses, targets, len(splits), free)
        if removals:
            trial = improve(trial, pruned(*made, removals))
        after, more = trial.history[-1][1], len(splits) - len(removals)
        if (free or more == 0) and after < (1 - KEEP - WORTH * max(more, 0)) * before:
            state, most, splits = trial._replace(history=(*state.history, (step, after))), None, None
        else:
            state, most = state._replace(history=(*state.history, (step, before))), len(splits) // 3
    if free and exchangeable(state.body):
        state = _thin_out(state, targets, improve, step)
    if len(state.history) == begun:
        state = state._replace(history=(*state.history, (step, state.history[-1][1])))
    return state


def _thin_out(
    state: LearnState,
    targets: Float[Array, "F V 3"],
    improve: Callable[[LearnState, Graft], LearnState],
    step: str,
) -> LearnState:
    """Joints that are not missed once all else has adapted go, where Q is no higher than before."""
    body, poses, before = state.body, state.motion.poses, state.history[-1][1]
    count = max(1, round(AT_ONCE / 2 * body.skeleton.num_joints))
    removals = spare(body, poses, targets, count, idle=False)
    if not removals:
        return state
    trial = improve(state, pruned(body, poses, state.pairs, removals))
    after = trial.history[-1][1]
    history = (*state.history, (step, min(after, before)))
    return (trial if after <= before else state)._replace(history=history)


def exchangeable(body: Body) -> bool:
    """Whether a tree is one that may be changed: balls under one free root."""
    kinds, parents = body.skeleton.kinds, body.skeleton.parents
    return kinds[0] == "free" and set(kinds[1:]) <= {"ball"} and parents.count(-1) == 1


def worthwhile(body: Body, poses: Pose, targets: Float[Array, "F V 3"]) -> list[Split]:
    """The splits that promise most and touch no joint of each other, as many as gain more than the
    removals of as many joints may cost."""
    least = PROMISE * float(jnp.sum((targets - deform_all(body, poses)) ** 2))
    splits, taken = [], set()
    for split in find_splits(body, poses, targets):
        if split.gain > least and not taken & _moved(split):
            splits.append(split)
            taken |= _moved(split)
    splits = splits[: max(1, round(AT_ONCE * body.skeleton.num_joints))]
    costs = np.cumsum([removal.cost for removal in find_removals(body, poses, targets)])
    gains = np.cumsum([split.gain for split in splits])
    number = min(len(costs), len(gains))
    paying = np.flatnonzero(gains[:number] > LASTING * costs[:number])
    return splits[: paying.max() + 1] if len(paying) else []


def spare(body: Body, poses: Pose, targets: Float[Array, "F V 3"], count: int, idle: bool) -> list[Removal]:
    """So many removals that cost least, no joint of which hangs on another; of `idle` joints only, on
    demand."""
    error = float(jnp.sum((targets - deform_all(body, poses)) ** 2))
    parents = body.skeleton.parents
    own = np.bincount(np.asarray(body.skin.parts()), minlength=len(parents))
    chosen: list[Removal] = []
    for removal in find_removals(body, poses, targets):
        beside = {parents[other.joint] for other in chosen} | {
            child for other in chosen for child, parent in enumerate(parents) if parent == other.joint
        }
        allowed = np.inf if not idle else error * (IDLE if own[removal.joint] else BARE)
        if len(chosen) < count and removal.joint not in beside and removal.cost < allowed:
            chosen.append(removal)
    return chosen


def grown(body: Body, poses: Pose, pairs: Int[np.ndarray, "P 2"], splits: Sequence[Split]) -> Graft:
    """The body with the joints of splits that touch no joint of each other."""
    names, made = list(body.skeleton.names), Graft(body, poses, pairs)
    for split in splits:
        skeleton = made.body.skeleton
        place = [skeleton.index(name) for name in names] + [skeleton.num_joints]
        shares = np.zeros((len(split.shares), skeleton.num_joints + 1))
        shares[:, place] = split.shares
        hung = tuple((place[joint], place[parent], centre) for joint, parent, centre in split.hung)
        made = with_joint(*made, split._replace(joint=place[split.joint], shares=shares, hung=hung))
    return made


def pruned(body: Body, poses: Pose, pairs: Int[np.ndarray, "P 2"], removals: Sequence[Removal]) -> Graft:
    """The body without some of its joints, of which none hangs on another."""
    old, made, gone = body.skeleton, Graft(body, poses, pairs), []
    for removal in removals:
        shares = np.array(removal.shares)
        # what it was to get of bones that are gone
        for joint in gone:
            shares[:, old.parents[joint]] += shares[:, joint]
        skeleton = made.body.skeleton
        columns = [old.index(name) for name in skeleton.names]
        here = removal._replace(joint=skeleton.index(old.names[removal.joint]), shares=shares[:, columns])
        made = without_joint(*made, here)
        gone.append(removal.joint)
    return made


def _moved(split: Split) -> set[int]:
    """The joints that a split hangs elsewhere, and those that they hang on, but for the new one."""
    ends = {split.joint, *(end for joint, parent, _ in split.hung for end in (joint, parent))}
    return ends - {split.shares.shape[1] - 1}
