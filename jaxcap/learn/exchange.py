"""Joints exchanged: one dissolved where two do the work of one, one made where a bone bends.

Parts that move rigidly are where learning starts, and soft regions have some of their own there.
Once weights blend, those are left over, while small parts that do move by themselves are still
in one with their neighbours. The residual tells which: of a bone whose vertices all go where they
should, nothing is gained by a split; and of a bone that is a blend of those around it, nothing is
lost.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Array, Float, Int

from ..body.body import Body
from ..body.pose import Pose
from .dissolve import find_removals
from .graft import Graft, Removal, Split, insert_share, with_joint, without_joint
from .objective import deform_all
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
    tries: int = 12,
) -> LearnState:
    """Exchange joints one by one, the most promising first, as long as Q falls.

    Every trial is improved, then kept where Q is lower than before, by more than a share `KEEP`;
    two in a row that are not end it. The history gets one entry of Q for each trial, named `step`.

    **Arguments:** `targets` the meshes of the state's body; `improve` puts a grafted body in the
    place of the state's and makes it better by a few rounds; `tries` at most.

    Only trees of "ball" joints under one "free" root are changed; others are given back as they are.
    """
    failures, refused, options = 0, set(), None
    for _ in range(tries):
        if failures == FAILURES or not exchangeable(state.body):
            break
        if options is None:
            options = propose(state.body, state.motion.poses, targets)
        names = state.body.skeleton.names
        options = [option for option in options if not refused & _touched(option, names)]
        if not options:
            break
        before = state.history[-1][1]
        trial = improve(state, graft(state.body, state.motion.poses, state.pairs, options[0]))
        after = trial.history[-1][1]
        kept = after < (1 - KEEP) * before
        history = (*state.history, (step, after if kept else before))
        if kept:
            state, failures, refused, options = trial, 0, set(), None
        else:
            failures, refused = failures + 1, refused | _touched(options[0], names)
        state = state._replace(history=history)
    return state


def exchangeable(body: Body) -> bool:
    """Whether a tree is one that may be changed: balls under one free root."""
    kinds, parents = body.skeleton.kinds, body.skeleton.parents
    return kinds[0] == "free" and set(kinds[1:]) <= {"ball"} and parents.count(-1) == 1


def propose(body: Body, poses: Pose, targets: Float[Array, "F V 3"]) -> list[Proposal]:
    """Exchanges that promise something, the most promising first: the best split and the cheapest
    removal, the next of both, and so on with every pairing of them."""
    errors = np.asarray(targets, float) - np.asarray(deform_all(body, poses), float)
    splits = find_splits(body, poses, errors)
    removals = find_removals(body, poses, targets)
    least = PROMISE * float(np.sum(errors**2))
    pairings = [
        Proposal(split, removal, split.gain - LASTING * removal.cost)
        for split in splits
        for removal in removals
        if split.joint != removal.joint
    ]
    return sorted((p for p in pairings if p.gain > least), key=lambda p: -p.gain)


def graft(body: Body, poses: Pose, pairs: Int[np.ndarray, "P 2"], proposal: Proposal) -> Graft:
    """The body with the proposed change."""
    made = Graft(body, poses, pairs)
    split, removal = proposal.split, proposal.removal
    names = body.skeleton.names
    if split is not None:
        made = with_joint(body, poses, pairs, split)
    if removal is None:
        return made
    if split is not None:
        there = made.body.skeleton.names
        wide = insert_share(removal.shares, split.joint, split.below[removal.vertices])
        new = next(name for name in there if name not in names)
        order = [[*names, new].index(name) for name in there]
        removal = removal._replace(joint=there.index(names[removal.joint]), shares=wide[:, order])
    return without_joint(*made, removal)


def _touched(proposal: Proposal, names: tuple[str, ...]) -> set[tuple[str, str]]:
    """What a refusal speaks against: this split, and this removal."""
    touched = set()
    if proposal.split is not None:
        touched.add(("split", names[proposal.split.joint]))
    if proposal.removal is not None:
        touched.add(("removal", names[proposal.removal.joint]))
    return touched
