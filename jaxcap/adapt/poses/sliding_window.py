"""Smooth motion: the poses of some frames at once, coupled by their second differences (Adaptation, 4.1.4)."""

from collections import deque
from collections.abc import Callable, Iterator, Sequence

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...arguments import checked
from ...body.body import Body
from ...body.limits.rotation_vector_boxes import PoseBoxes
from ...body.pose import Pose
from ...body.skeleton import Skeleton
from ...energy.data.pairs import Pairs
from ...energy.energy import AbstractEnergy
from ...energy.priors.temporal import second_difference
from ...fit.alternate import alternate
from ...fit.sequences.problem import SequenceEstimate, SequenceProblem
from ...fit.solvers.levenberg_marquardt import LevenbergMarquardt
from ...parallel import parallel_map
from ..problems import stack, stack_pairs, unstack, window_problem
from .pose import LENGTHS, UPHILL, brought_in, same_pose

#: frames of a window, and by how many the next one is further on
FRAMES, STRIDE = 11, 5
#: damping of a window's first step, as a share of each curvature
DAMPING = 1e-4


@checked
def smooth_poses(
    body: Body,
    poses: list[Pose],
    pairs_at: Callable[[int, Pose], Pairs],
    prior: AbstractEnergy,
    weight: float,
    temporal: float,
    *,
    frames: int = FRAMES,
    stride: int = STRIDE,
    steps: int = 2,
    boxes: PoseBoxes | None = None,
    terms: AbstractEnergy | None = None,
    times: Sequence[int] | None = None,
) -> list[Pose]:
    """Poses of a whole sequence by windows that overlap, each with its first frame held where the window
    before left it; memory is that of one window.

    A step of a window is one of damped normal equations, block-banded over the frames, of which the best of some lengths
    is taken. New pairs may make a window worse; the best of its poses are kept.

    **Arguments:** `pairs_at(frame, pose)` gives the pairs of a frame; `weight` of the prior and `temporal` of the
    second differences, against the mean squared distance of a pair (eqs. 4.3, 4.9); `boxes` are hard, as in
    `fit_pose`, and poses that are beyond them are brought back first; `terms` as there; `times` of the poses, frames that rise, where some
    are missing between them.
    """
    windows = smooth_windows(
        body, poses, pairs_at, prior, weight, temporal,
        frames=frames, stride=stride, steps=steps, boxes=boxes, terms=terms, times=times,
    )  # fmt: skip
    (last,) = deque(windows, maxlen=1)
    return last[0]


def smooth_windows(
    body: Body,
    poses: list[Pose],
    pairs_at: Callable[[int, Pose], Pairs],
    prior: AbstractEnergy,
    weight: float,
    temporal: float,
    *,
    frames: int = FRAMES,
    stride: int = STRIDE,
    steps: int = 2,
    boxes: PoseBoxes | None = None,
    terms: AbstractEnergy | None = None,
    times: Sequence[int] | None = None,
    begin: int = 0,
) -> Iterator[tuple[list[Pose], int]]:
    """`smooth_poses`, window by window: all poses after each of them, and the first frame of the next one, at which
    `begin` goes on from these poses to the same end; after the last window it is how many poses there are."""
    when = np.arange(len(poses)) if times is None else np.asarray(times)
    if not begin and boxes is not None:
        poses = [brought_in(boxes, body.skeleton, pose) for pose in poses]
    poses, known = list(poses), {}

    def pairs_of_frames(window: dict[int, Pose]) -> list[Pairs]:
        # a held frame, and one that the window before left, is where it was
        moved = {n: at for n, at in window.items() if n not in known or not same_pose(known[n][0], at)}
        found = parallel_map(lambda each: pairs_at(*each), moved.items())
        known.update((n, (at, pairs)) for (n, at), pairs in zip(moved.items(), found, strict=True))
        return [known[n][1] for n in window]

    if len(poses) < 3:
        yield poses, len(poses)
        return
    solver = LevenbergMarquardt(rtol=0.0, atol=0.0, damping=DAMPING, relative=True, lengths=LENGTHS)
    start = begin
    while start < len(poses):
        stop = min(start + frames, len(poses))
        # a window of another length would be compiled anew, so the last one begins earlier
        start = max(stop - frames, 0)
        for frame in [frame for frame in known if frame < start]:
            del known[frame]
        first, last = start, stop

        def remake(y: SequenceEstimate, first: int = first, last: int = last) -> SequenceProblem:
            window = dict(enumerate(unstack(y.poses, last - first), first))
            pairs = stack_pairs(pairs_of_frames(window))
            return window_problem(
                body,
                pairs,
                prior,
                weight,
                temporal,
                when[first:last],
                boxes,
                held=int(first > 0),
                terms=terms,
            )

        estimate = SequenceEstimate(stack(poses[start:stop]), {})
        best = alternate(remake, estimate, solver, rounds=steps, uphill=UPHILL)
        poses[start:stop] = unstack(best.y.poses, stop - start)
        start = stop if stop == len(poses) else min(start + stride, len(poses) - frames)
        yield list(poses), start


def temporal_energy(
    skeleton: Skeleton, poses: Pose, since: Float[Array, "G"] | None = None
) -> Float[Array, ""]:
    """`Q_temp` (eqs. 4.9 and 4.10): the mean over inner frames and joints of the squared difference of a
    rotation vector from the mean of its neighbours', radians squared. `since` are the frames from each pose to
    the next, one where not given."""
    q = poses.rotations
    since = jnp.ones(len(q) - 1) if since is None else since
    apart = second_difference(q[:-2], q[1:-1], q[2:], since[:-1], since[1:])
    return jnp.sum(apart**2) / (apart.shape[0] * apart.shape[1])
