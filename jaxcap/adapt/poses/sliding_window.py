"""Smooth motion: poses of a sliding window, coupled by their second differences (Adaptation, 4.1.4)."""

from collections import deque
from collections.abc import Callable, Iterator, Sequence

import numpy as np

from ...arguments import checked
from ...body.body import Body
from ...body.pose import Pose
from ...energy.data.pairs import PointPairs, stack_pairs
from ...fit.alternate import alternate
from ...fit.sequences.sequence_problem import SequenceEstimate, SequenceProblem
from ...fit.solvers.levenberg_marquardt import LevenbergMarquardt
from ...stacking import stack_trees, unstack_trees
from ..objective import PoseTerms, window_problem
from .fit_frame import MAX_UPHILL_STEPS, STEP_FACTORS, clamp_pose
from .pair_cache import PairCache

#: number of frames of a window, and number of frames by which it advances
WINDOW_FRAMES, STRIDE = 11, 5
#: damping of a window's first step, as a share of each curvature
DAMPING = 1e-4


@checked
def smooth_poses(
    body: Body,
    poses: list[Pose],
    pairs_at: Callable[[int, Pose], PointPairs],
    terms: PoseTerms,
    temporal_weight: float,
    *,
    frames: int = WINDOW_FRAMES,
    stride: int = STRIDE,
    steps: int = 2,
    times: Sequence[int] | None = None,
) -> list[Pose]:
    """Smooth the poses of a whole sequence in overlapping windows.

    The first frame of each window is fixed at the result of the window before. Memory is that of one window.
    A step solves damped normal equations, block-banded over the frames, at the best of some lengths. New
    pairs may raise the energy of a window; its best poses are kept.

    **Arguments:** `pairs_at(frame, pose)` returns the pairs of a frame; `temporal_weight`, the weight of
    the second differences, relative to the mean squared distance of a pair (eqs. 4.3, 4.9); `terms` as in
    `fit_pose`; `times`, the ascending frame numbers of the poses, if some frames between them are missing.
    """
    # the pairs of a frame are found without a scan
    cache = PairCache(lambda frame: frame, lambda _, pose, frame: pairs_at(frame, pose))
    windows = smooth_windows(
        body, poses, cache, terms, temporal_weight, frames=frames, stride=stride, steps=steps, times=times
    )
    (last,) = deque(windows, maxlen=1)
    return last[0]


def smooth_windows(
    body: Body,
    poses: list[Pose],
    pair_cache: PairCache,
    terms: PoseTerms,
    temporal_weight: float,
    *,
    frames: int = WINDOW_FRAMES,
    stride: int = STRIDE,
    steps: int = 2,
    times: Sequence[int] | None = None,
    resume_frame: int = 0,
) -> Iterator[tuple[list[Pose], int]]:
    """Smooth poses as `smooth_poses`; yield all poses and the next window's first frame after each window.

    `pair_cache` numbers the poses from 0. `resume_frame` at this frame resumes from these poses with the same
    result. After the last window it is the number of poses.
    """
    when = np.arange(len(poses)) if times is None else np.asarray(times)
    if not resume_frame and terms.boxes is not None:
        poses = [clamp_pose(terms.boxes, body.skeleton, pose) for pose in poses]
    poses = list(poses)
    if len(poses) < 3:
        yield poses, len(poses)
        return
    solver = LevenbergMarquardt(rtol=0.0, atol=0.0, damping=DAMPING, relative=True, lengths=STEP_FACTORS)
    start = resume_frame
    while start < len(poses):
        stop = min(start + frames, len(poses))
        # the last window begins earlier, as another length would compile again
        start = max(stop - frames, 0)
        first, last = start, stop

        def remake(y: SequenceEstimate, first: int = first, last: int = last) -> SequenceProblem:
            window = dict(enumerate(unstack_trees(y.poses, last - first), first))
            # unchanged poses keep their pairs: the fixed one, and those from the window before
            pairs = stack_pairs(pair_cache.pairs(body, window))
            return window_problem(body, pairs, terms, temporal_weight, when[first:last], int(first > 0))

        estimate = SequenceEstimate(stack_trees(poses[start:stop]), {})
        best = alternate(remake, estimate, solver, rounds=steps, patience=MAX_UPHILL_STEPS)
        poses[start:stop] = unstack_trees(best.y.poses, stop - start)
        start = stop if stop == len(poses) else min(start + stride, len(poses) - frames)
        yield list(poses), start
