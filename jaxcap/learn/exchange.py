"""Joints exchanged: one dissolved where two do the work of one, one made where a bone bends.

Parts that move rigidly are where learning starts, and soft regions have some of their own there.
Once weights blend, those are left over, while small parts that do move by themselves are still
in one with their neighbours. The residual tells which: of a bone whose vertices all go where they
should, nothing is gained by a split; and of a bone that is a blend of those around it, nothing is
lost.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Array, Float, Int

from ..body.body import Body, deform_all
from ..body.pose import Pose
from .dissolve import find_removals
from .graft import Graft, Removal, Split, insert_share, with_joint, without_joint
from .splits import find_splits
from .state import LearnState

#: the share of a removal's cost that is left when poses, centres and rest shape have adapted to it
LASTING = 0.5
#: what an exchange has to promise, and what it has to keep, as shares of the error
PROMISE, KEEP = 0.01, 0.005
#: exchanges that may fail in a row
FAILURES = 2


class Proposal(NamedTuple):
    """A change of the tree that may lower the sum of squared distances by `gain`, square metres."""

    split: Split | None
    removal: Removal | None
    gain: float


def exchange(
    state: LearnState,
    targets: Float[Array, "F V 3"],
    improve: Callable[[LearnState, Graft], LearnState],
    step: str = "exchange",
    tries: int = 6,
) -> LearnState:
    """Exchange joints, the most promising first, as long as Q falls.

    All exchanges that promise something and do not touch each other are tried at once; where that
    fails, one by one. What is tried is improved, then kept where Q is lower than before, by more
    than a share `KEEP`; two failures in a row end it. The history gets one entry of Q for each
    trial, named `step`; one, too, where nothing is worth a trial.

    **Arguments:** `targets` the meshes of the state's body; `improve` puts a grafted body in the
    place of the state's and makes it better by a few rounds; `tries` at most.

    Only trees of "ball" joints under one "free" root are changed; others are given back as they are.
    """
    failures, queue, begun = 0, None, len(state.history)
    for _ in range(tries if exchangeable(state.body) else 0):
        if queue is None:
            singles = apart(propose(state.body, state.motion.poses, targets))
            queue = ([singles] if len(singles) > 1 else []) + [[single] for single in singles]
        if failures == FAILURES or not queue:
            break
        before, chosen = state.history[-1][1], queue.pop(0)
        trial = improve(state, graft(state.body, state.motion.poses, state.pairs, chosen))
        after = trial.history[-1][1]
        if after < (1 - KEEP) * before:
            state, failures, queue = trial._replace(history=(*state.history, (step, after))), 0, None
        else:
            state, failures = state._replace(history=(*state.history, (step, before))), failures + 1
    if len(state.history) == begun:
        state = state._replace(history=(*state.history, (step, state.history[-1][1])))
    return state


def exchangeable(body: Body) -> bool:
    """Whether a tree is one that may be changed: balls under one free root."""
    kinds, parents = body.skeleton.kinds, body.skeleton.parents
    return kinds[0] == "free" and set(kinds[1:]) <= {"ball"} and parents.count(-1) == 1


def propose(body: Body, poses: Pose, targets: Float[Array, "F V 3"]) -> list[Proposal]:
    """Every pairing of a split and a removal that promises something, the most promising first."""
    errors = np.asarray(targets, float) - np.asarray(deform_all(body, poses), float)
    splits = find_splits(body, poses, errors)
    removals = find_removals(body, poses, targets)
    least = PROMISE * float(np.sum(errors**2))
    pairings = [
        Proposal(split, removal, split.gain - LASTING * removal.cost)
        for split in splits
        for removal in removals
    ]
    return sorted((p for p in pairings if p.gain > least and len(_touched(p)) == 2), key=lambda p: -p.gain)


def apart(proposals: Sequence[Proposal]) -> list[Proposal]:
    """From the first one on, the proposals that touch no joint of those before."""
    chosen, taken = [], set()
    for proposal in proposals:
        if not taken & _touched(proposal):
            chosen.append(proposal)
            taken |= _touched(proposal)
    return chosen


def graft(body: Body, poses: Pose, pairs: Int[np.ndarray, "P 2"], proposals: Sequence[Proposal]) -> Graft:
    """The body with the proposed changes, which are apart: first all splits, then all removals."""
    old, made = body.skeleton, Graft(body, poses, pairs)
    splits = [p.split for p in proposals if p.split is not None]
    removals = [p.removal for p in proposals if p.removal is not None]
    names = list(old.names)
    for split in splits:
        before = made.body.skeleton
        children = tuple(before.index(old.names[child]) for child in split.children)
        here = split._replace(joint=before.index(old.names[split.joint]), children=children)
        made = with_joint(*made, here)
        names += sorted(set(made.body.skeleton.names) - set(names))
    gone: list[int] = []
    for removal in removals:
        shares = np.array(removal.shares)
        for split in splits:
            shares = insert_share(shares, split.joint, split.below[removal.vertices])
        for joint in sorted(gone, reverse=True):
            shares[:, old.parents[joint]] += shares[:, joint]
        there = made.body.skeleton
        columns = [names.index(name) for name in there.names]
        here = removal._replace(joint=there.index(old.names[removal.joint]), shares=shares[:, columns])
        made = without_joint(*made, here)
        gone.append(removal.joint)
    return made


def _touched(proposal: Proposal) -> set[int]:
    return {change.joint for change in (proposal.split, proposal.removal) if change is not None}
