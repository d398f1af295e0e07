"""The history of an adaptation: the value of each term after each stage."""

from collections.abc import Sequence

import numpy as np

from ..stacking import stack_trees
from .objective import Terms, mean_squared_distance, motion_energy, pose_energy, symmetry_energy
from .poses.pair_cache import PairCache, make_pair_cache
from .shape.reference import shape_prior_of
from .shape.shape_prior import shape_energy
from .task import AdaptState, AdaptTask


def append_history(
    task: AdaptTask, state: AdaptState, name: str, frames: Sequence[int], pair_cache: PairCache | None = None
) -> AdaptState:
    """Append a stage's terms in some frames to the state's history; `pair_cache` may cache their pairs."""
    body, poses = state.body, {frame: state.motion[frame] for frame in frames}
    pairs = (make_pair_cache(task) if pair_cache is None else pair_cache).pairs(body, poses)
    stacked = stack_trees(list(poses.values()))
    squares = [
        mean_squared_distance(body, pose, some) for pose, some in zip(poses.values(), pairs, strict=True)
    ]
    terms = Terms(
        data=float(np.mean(squares)),
        pose=pose_energy(task.prior, body, stacked),
        temporal=0.0 if task.settings.unordered else motion_energy(body.skeleton, state.motion),
        shape=shape_energy(shape_prior_of(task, state), body),
        symmetry=symmetry_energy(body.skeleton, task.left_right_pairs),
        user=0.0 if task.terms is None else pose_energy(task.terms, body, stacked),
    )
    reached = (name, 1000 * float(np.sqrt(terms.data)))
    return state._replace(history=(*state.history, reached), terms=(*state.terms, terms))
