"""Smooth motion: the poses of some frames at once, coupled by their second differences (Adaptation, 4.1.4)."""

import math
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from ..arguments import checked
from ..body.body import Body
from ..body.pose import Pose, retract
from ..body.pose_boxes import BoxChart, PoseBoxes, box_chart, move_within, no_boxes
from ..body.skeleton import Skeleton
from ..energy.temporal import second_difference
from ..energy.term import AbstractEnergy
from ..fit.correspond import Pairs
from ..fit.solvers.block_banded import BlockBanded, banded_equations, frames_before
from ..fit.solvers.boxes import solve_boxed
from .equations import frame_energy, frame_equations, stack, stack_pairs, unstack
from .pose import SHARES, UPHILL, best_share, brought_in

#: frames of a window, and by how many the next one is further on
FRAMES, STRIDE = 11, 5


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
    times: Sequence[int] | None = None,
) -> list[Pose]:
    """Poses of a whole sequence by windows that overlap, each with its first frame held where the window
    before left it; memory is that of one window.

    A step of a window is one of damped normal equations, block-banded over the frames, of which the best of some lengths
    is taken. New pairs may make a window worse; the best of its poses are kept.

    **Arguments:** `pairs_at(frame, pose)` gives the pairs of a frame; `weight` of the prior and `temporal` of the
    second differences, against the mean squared distance of a pair (eqs. 4.3, 4.9); `boxes` are hard, as in
    `fit_pose`, and poses that are beyond them are brought back first; `times` of the poses, frames that rise, where some
    are missing between them.
    """
    windows = smooth_windows(
        body, poses, pairs_at, prior, weight, temporal,
        frames=frames, stride=stride, steps=steps, boxes=boxes, times=times,
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
    times: Sequence[int] | None = None,
    begin: int = 0,
) -> Iterator[tuple[list[Pose], int]]:
    """`smooth_poses`, window by window: all poses after each of them, and the first frame of the next one, at which
    `begin` goes on from these poses to the same end; after the last window it is how many poses there are."""
    when = np.arange(len(poses)) if times is None else np.asarray(times)
    boxes = no_boxes() if boxes is None else boxes
    weights = jnp.asarray(weight, float), jnp.asarray(temporal, float)
    poses = list(poses) if begin else [brought_in(boxes, body.skeleton, pose) for pose in poses]
    known: dict[int, tuple[Pose, Pairs]] = {}

    def pairs_of_frame(frame: int, pose: Pose) -> Pairs:
        # a held frame, and one that the window before left, is where it was
        if frame not in known or known[frame][0] is not pose:
            known[frame] = pose, pairs_at(frame, pose)
        return known[frame][1]

    if len(poses) < 3:
        yield poses, len(poses)
        return
    start = begin
    while start < len(poses):
        stop = min(start + frames, len(poses))
        # a window of another length would be compiled anew, so the last one begins earlier
        start = max(stop - frames, 0)
        for frame in [frame for frame in known if frame < start]:
            del known[frame]
        held, window = int(start > 0), poses[start:stop]
        since = jnp.asarray(np.diff(when[start:stop]), float)
        best, worse = (math.inf, window), 0
        for step in range(steps + 1):
            pairs = stack_pairs([pairs_of_frame(start + i, pose) for i, pose in enumerate(window)])
            total = float(window_energy(body, stack(window), pairs, prior, *weights, since))
            if total < best[0]:
                best, worse = (total, window), 0
            else:
                worse += 1
            if step == steps or worse > UPHILL:
                break
            moved = _improve(body, stack(window), pairs, prior, boxes, *weights, jnp.asarray(held > 0), since)
            window = window[:held] + unstack(moved, stop - start)[held:]
        poses[start:stop] = best[1]
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


@eqx.filter_jit
def window_energy(
    body: Body,
    poses: Pose,
    pairs: Pairs,
    prior: AbstractEnergy,
    weight: Float[Array, ""],
    temporal: Float[Array, ""],
    since: Float[Array, "G"] | None = None,
) -> Float[Array, ""]:
    """`Q` of the poses of some frames (eq. 4.3): the mean over frames of `Q_data + weight Q_pose`, which is what
    `fit_pose` makes least, and `temporal Q_temp`."""
    each = jax.lax.map(lambda frame: frame_energy(body, frame[0], frame[1], prior, weight), (poses, pairs))
    return jnp.mean(each) + temporal * temporal_energy(body.skeleton, poses, since)


def window_step(
    body: Body,
    poses: Pose,
    pairs: Pairs,
    prior: AbstractEnergy,
    boxes: PoseBoxes,
    weight: Float[Array, ""],
    temporal: Float[Array, ""],
    held: Bool[Array, ""],
    since: Float[Array, "G"] | None = None,
) -> tuple[BoxChart, Float[Array, "F D"]]:
    """The damped step of all frames of a window within their boxes, and the charts whose numbers it is by.

    Frames meet through their second differences, which couple a frame with the two before it.
    """
    skeleton, frames = body.skeleton, poses.scale.shape[0]
    own, sides = jax.lax.map(
        lambda frame: frame_equations(body, frame[0], frame[1], prior, weight), (poses, pairs)
    )
    slopes, rough = _temporal_rows(skeleton, poses, since)
    banded, smooth_sides = banded_equations(slopes, -rough)
    blocks = (temporal * banded.blocks).at[:, 0].add(own / frames)
    sides = sides / frames + temporal * smooth_sides
    # the held frame does not move
    free = jnp.ones_like(sides, bool).at[0].set(~held)
    diagonal = jnp.diagonal(blocks[:, 0], axis1=1, axis2=2)
    ridge = 1e-4 * diagonal + 1e-7 * jnp.max(diagonal)
    blocks = BlockBanded(blocks).add_diagonal(ridge).blocks
    # bounds are on the numbers of the frames' charts, and so is the step
    charts = jax.vmap(box_chart, (None, None, 0))(boxes, skeleton, poses)
    banded, sides = _by_charts(charts, blocks, sides)
    step = solve_boxed(banded.among(free), jnp.where(free, sides, 0.0), charts.low, charts.high)
    return charts, step


@eqx.filter_jit
def _improve(
    body: Body,
    poses: Pose,
    pairs: Pairs,
    prior: AbstractEnergy,
    boxes: PoseBoxes,
    weight: Float[Array, ""],
    temporal: Float[Array, ""],
    held: Bool[Array, ""],
    since: Float[Array, "G"],
) -> Pose:
    """The poses after the best length of a step for these pairs, which may be none."""
    charts, step = window_step(body, poses, pairs, prior, boxes, weight, temporal, held, since)

    def moved(share):
        move = jax.vmap(move_within, (None, None, 0, 0, 0))
        return move(boxes, body.skeleton, poses, charts, share * step)

    def value(share):
        return window_energy(body, moved(share), pairs, prior, weight, temporal, since)

    shares = jnp.asarray([*SHARES, 0.0], step.dtype)
    values = jax.lax.map(value, shares)
    return moved(best_share(shares, values))


def _temporal_rows(
    skeleton: Skeleton, poses: Pose, since: Float[Array, "G"] | None
) -> tuple[Float[Array, "K 3 R D"], Float[Array, "K R"]]:
    """The residual of `Q_temp`, an inner frame after the other, and its Jacobian by the frame before, its own and the
    one after."""
    inner = poses.scale.shape[0] - 2
    since = jnp.ones(inner + 1) if since is None else since
    threes = jax.tree.map(lambda leaf: jnp.stack([leaf[:-2], leaf[1:-1], leaf[2:]], 1), poses)

    def rows(three, since, until):
        def residual(d):
            q = jax.vmap(retract, (None, 0, 0))(skeleton, three, d).rotations
            apart = second_difference(q[0], q[1], q[2], since, until)
            apart = apart.reshape(-1) / jnp.sqrt(jnp.asarray(inner * len(apart), apart.dtype))
            return apart, apart

        zero = jnp.zeros((3, skeleton.num_dofs), three.rotations.dtype)
        slope, apart = jax.jacfwd(residual, has_aux=True)(zero)
        return jnp.swapaxes(slope, 0, 1), apart

    return jax.vmap(rows)(threes, since[:-1], since[1:])


def _by_charts(
    charts: BoxChart, blocks: Float[Array, "F B D D"], sides: Float[Array, "F D"]
) -> tuple[BlockBanded, Float[Array, "F D"]]:
    """Normal equations of the frames' tangents as those of their charts' numbers."""
    product = partial(jnp.einsum, precision="highest")
    before = frames_before(charts.turn, blocks.shape[1])
    turned = product("fai,fwab,fwbj->fwij", charts.turn, blocks, before)
    return BlockBanded(turned), product("fai,fa->fi", charts.turn, sides)
