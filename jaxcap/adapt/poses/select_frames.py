"""Selection of some frames of a motion."""

from collections.abc import Sequence

import jax
import numpy as np

from ...body.people.sample import select_diverse_poses
from ...geometry.sampling import even_indices
from ..task import AdaptState


def select_evenly(frames: Sequence[int], count: int = 8) -> list[int]:
    """Select at most `count` frames, spread evenly."""
    return [frames[row] for row in even_indices(len(frames), count)]


def spread_frames(state: AdaptState, count: int, num_candidates: int | None = None) -> tuple[int, ...]:
    """Choose `count` frames with dissimilar poses among the first `num_candidates` ones by farthest-point sampling.

    Lost frames are excluded.
    """
    there = [n for n in range(len(state.motion))[:num_candidates] if n not in state.lost] or [0]
    some = jax.tree.map(lambda leaf: leaf[np.array(there)], state.motion.poses)
    return tuple(there[n] for n in select_diverse_poses(state.body.skeleton, some, count))
