"""Smooth motion: the poses of some frames at once, coupled by their second differences (Adaptation, 4.1.4)."""

from collections.abc import Callable
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from ..body.body import Body
from ..body.pose import Pose, retract
from ..body.pose_boxes import PoseBoxes, box_chart, move_within, no_boxes
from ..body.skeleton import Skeleton
from ..energy.term import AbstractEnergy
from ..fit.boxed import solve_boxed
from ..fit.correspond import Pairs
from ..fit.problem import linearise
from ..geometry import rotation
from .equations import num_pairs, pose_equations, stack, stack_pairs, unstack
from .pose import brought_in

#: frames of a window, and by how many the next one is further on
FRAMES, STRIDE = 11, 5


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
) -> list[Pose]:
    """Poses of a whole sequence by windows that overlap, each with its first frame held where the window
    before left it; memory is that of one window.

    **Arguments:** `pairs_at(frame, pose)` gives the pairs of a frame; `weight` of the prior and `temporal` of the
    second differences, against the mean squared distance of a pair (eqs. 4.3, 4.9); `boxes` are hard, as in
    `fit_pose`, and poses that are beyond them are brought back first.
    """
    boxes = no_boxes() if boxes is None else boxes
    poses = [brought_in(boxes, body.skeleton, pose) for pose in poses]
    for start in range(0, max(len(poses) - 2, 1), stride):
        stop = min(start + frames, len(poses))
        # a window of another length would be compiled anew, so the last one begins earlier
        start = max(stop - frames, 0)
        if stop - start < 3:
            break
        window = poses[start:stop]
        for _ in range(steps):
            pairs = stack_pairs([pairs_at(start + i, pose) for i, pose in enumerate(window)])
            moved = _improve(
                body,
                stack(window),
                pairs,
                prior,
                boxes,
                jnp.asarray(weight, float),
                jnp.asarray(temporal, float),
                jnp.asarray(start > 0),
            )
            window = unstack(moved, stop - start)
        poses[start:stop] = window
        if stop == len(poses):
            break
    return poses


def temporal_energy(skeleton: Skeleton, poses: Pose) -> Float[Array, ""]:
    """`Q_temp` (eqs. 4.9 and 4.10): the mean over inner frames and joints of the squared difference of a
    rotation vector from the mean of its neighbours', radians squared."""
    r = _second_differences(skeleton, poses, jnp.zeros((len(poses.scale), skeleton.num_dofs)))
    return jnp.sum(r**2)


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
) -> Pose:
    skeleton, dofs = body.skeleton, body.skeleton.num_dofs
    frames = poses.scale.shape[0]

    def of_frame(frame):
        pose, pairs = frame
        count = num_pairs(pairs)
        matrix, side, _ = pose_equations(body, pose, pairs)
        residual, jacobian = linearise(prior, body, pose)
        return (
            matrix / count + weight * jacobian.T @ jacobian,
            side / count - weight * jacobian.T @ residual,
        )

    blocks, sides = jax.lax.map(of_frame, (poses, pairs))
    matrix = jnp.zeros((frames, dofs, frames, dofs), sides.dtype)
    every = jnp.arange(frames)
    matrix = matrix.at[every, :, every].set(blocks / frames).reshape(frames * dofs, frames * dofs)
    side = sides.reshape(-1) / frames

    def rough(d):
        r = _second_differences(skeleton, poses, d.reshape(frames, dofs))
        return r, r

    slope, r = jax.jacfwd(rough, has_aux=True)(jnp.zeros(frames * dofs, sides.dtype))
    matrix = matrix + temporal * slope.T @ slope
    side = side - temporal * slope.T @ r
    # the held frame does not move
    free = jnp.where(held & (jnp.arange(frames * dofs) < dofs), 0.0, 1.0)
    diagonal = jnp.diag(matrix)
    ridge = 1e-4 * diagonal + 1e-7 * jnp.max(diagonal)
    matrix = matrix * free[:, None] * free + jnp.diag(jnp.where(free > 0, ridge, 1.0))
    # bounds are on the numbers of the frames' charts, and so is the step
    charts = jax.vmap(box_chart, (None, None, 0))(boxes, skeleton, poses)
    product = partial(jnp.einsum, precision="highest")
    matrix = product("faGb,Gbj->faGj", matrix.reshape(frames, dofs, frames, dofs), charts.turn)
    matrix = product("fai,faGj->fiGj", charts.turn, matrix).reshape(frames * dofs, frames * dofs)
    side = product("fai,fa->fi", charts.turn, (free * side).reshape(frames, dofs)).reshape(-1)
    step = solve_boxed(matrix, side, charts.low.reshape(-1), charts.high.reshape(-1))
    move = jax.vmap(move_within, (None, None, 0, 0, 0))
    return move(boxes, skeleton, poses, charts, step.reshape(frames, dofs))


def _second_differences(skeleton: Skeleton, poses: Pose, d: Float[Array, "F D"]) -> Float[Array, "R"]:
    """Half the sum of the rotation vectors to the frame before and to the one after: those of eq. 4.10 from the
    pose between the two, so that none is near half a turn however far a motion turns in all."""
    q = jax.vmap(retract, (None, 0, 0))(skeleton, poses, d.astype(poses.rotations.dtype)).rotations
    back = rotation.conjugate(q[1:-1])
    inner = (rotation.log(rotation.multiply(back, q[:-2])) + rotation.log(rotation.multiply(back, q[2:]))) / 2
    return inner.reshape(-1) / jnp.sqrt(inner.shape[0] * inner.shape[1])
