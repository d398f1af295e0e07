"""The pose of one frame: pairs, a damped step, and again (Adaptation, 4.1.4)."""

from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..arguments import checked
from ..body.body import Body, pose_body
from ..body.pose import Pose
from ..body.pose_boxes import PoseBoxes, box_chart, chart_equations, move_within, no_boxes
from ..body.skeleton import Skeleton
from ..energy.term import AbstractEnergy
from ..fit.correspond import Matching, Pairs, Scan, find_pairs
from ..fit.solvers.boxes import solve_boxed
from ..fit.visible import visible_vertices
from ..geometry.camera import Camera
from .equations import frame_energy, frame_equations, num_pairs, pair_energy

#: shares of a step that are tried: further than it says, as it says, and shorter
SHARES = (1.5, 1.0, 0.5, 0.25, 0.1)
#: how damping changes with the share of a step that was good: at most the first, at least the second; and its largest value
SHORT, WHOLE, FACTOR, MOST_DAMPED = 0.25, 1.0, 10.0, 1e3
#: steps that may raise Q before the best pose is returned to
UPHILL = 2
#: rows and columns of the buffers that tell what cameras see: as rays do of 98 % of vertices and more
PIXELS = 256


class PoseFit(NamedTuple):
    """A pose and how well it meets its scan."""

    pose: Pose
    #: mean weighed squared distance of a pair, metres squared, and that of the priors beside it
    data: float
    prior: float
    #: the last pairs
    pairs: Pairs


@checked
def fit_pose(
    body: Body,
    scan: Scan,
    start: Pose,
    prior: AbstractEnergy,
    matching: Matching = Matching(),
    *,
    weight: float = 1e-6,
    steps: int = 10,
    damping: float = 1e-3,
    cameras: Sequence[Camera] = (),
    boxes: PoseBoxes | None = None,
) -> PoseFit:
    """The pose of a frame from one near it: Q_data + weight Q_prior, with Q_data the mean over pairs.

    Each step finds pairs anew, solves the damped normal equations, and takes the best of some lengths of
    the step for these pairs (Adaptation: Levenberg-Marquardt for the direction, a search along it for the
    length). `damping` is that of the first step: it grows where only a small share of a step was good, and falls again
    where all of it was. New pairs may raise Q; some such steps are gone on from, and the best pose is kept.

    `boxes` are hard: a number that a step would carry beyond its end is set to that end, and the others are
    solved for again. What the start has beyond them is brought back first. `cameras` as in `pairs_of`.
    """
    faces = np.asarray(body.faces)
    boxes = no_boxes() if boxes is None else boxes
    start = brought_in(boxes, body.skeleton, start)
    pose, best, worse, damped = start, None, 0, damping
    for _ in range(steps):
        pairs = _pairs(body, pose, faces, scan, matching, cameras)
        data, beside = (float(value) for value in _values(body, pose, pairs, prior))
        total = data + weight * beside
        if best is None or total < best[0] * (1 - 1e-3):
            best, worse = (total, PoseFit(pose, data, beside, pairs)), 0
        else:
            worse += 1
            if worse > UPHILL:
                break
        amounts = jnp.asarray(weight, float), jnp.asarray(damped, float)
        pose, share = _improve(body, pose, pairs, prior, boxes, *amounts)
        damped = min(max(damping, damped * _growth(float(share))), MOST_DAMPED)
    else:
        pairs = _pairs(body, pose, faces, scan, matching, cameras)
        data, beside = (float(value) for value in _values(body, pose, pairs, prior))
        if best is None or data + weight * beside < best[0]:
            return PoseFit(pose, data, beside, pairs)
    assert best is not None
    return best[1]


def _growth(share: float) -> float:
    """By how much the damping of the next step is larger."""
    if share <= SHORT:
        return FACTOR
    return 1.0 / FACTOR if share >= WHOLE else 1.0


def pairs_of(
    body: Body,
    pose: Pose,
    scan: Scan,
    matching: Matching,
    cameras: Sequence[Camera] = (),
) -> Pairs:
    """The pairs of a posed body with a scan. Vertices that none of the `cameras` sees are in no pair (4.1.2, visibility
    constraint); no cameras say nothing."""
    return _pairs(body, pose, np.asarray(body.faces), scan, matching, cameras)


def mean_square(body: Body, pose: Pose, pairs: Pairs) -> float:
    """The mean weighed squared distance of a pair, metres squared."""
    return float(_mean_square(body, pose, pairs))


@eqx.filter_jit
def _mean_square(body: Body, pose: Pose, pairs: Pairs) -> Float[Array, ""]:
    return pair_energy(body, pose, pairs) / num_pairs(pairs)


def _pairs(body, pose, faces, scan, matching, cameras) -> Pairs:
    posed, normals = _surface(body, pose)
    visible = np.asarray(visible_vertices(cameras, posed, body.faces, pixels=PIXELS)) if cameras else None
    return find_pairs(np.asarray(posed, float), np.asarray(normals, float), faces, scan, matching, visible)


@eqx.filter_jit
def _surface(body: Body, pose: Pose):
    posed = pose_body(body, pose)
    return posed.vertices, posed.normals


@eqx.filter_jit
def _values(body: Body, pose: Pose, pairs: Pairs, prior: AbstractEnergy):
    beside = prior.residual(pose_body(body, pose))
    return pair_energy(body, pose, pairs) / num_pairs(pairs), beside @ beside


@eqx.filter_jit
def brought_in(boxes: PoseBoxes, skeleton: Skeleton, pose: Pose) -> Pose:
    """The pose with every number that is beyond its box at the end of it."""
    return boxes.nearest(skeleton, pose)


@eqx.filter_jit
def _improve(
    body: Body,
    pose: Pose,
    pairs: Pairs,
    prior: AbstractEnergy,
    boxes: PoseBoxes,
    weight: Float[Array, ""],
    damping: Float[Array, ""],
) -> tuple[Pose, Float[Array, ""]]:
    """The pose a step further, and the share of the step that was best."""
    skeleton = body.skeleton
    matrix, side = frame_equations(body, pose, pairs, prior, weight)
    diagonal = jnp.diag(matrix)
    floor = 1e-6 * jnp.max(diagonal)
    damped = matrix + jnp.diag(damping * diagonal + floor)
    # bounds are on the numbers of the chart, and so is the step
    chart = box_chart(boxes, skeleton, pose)
    step = solve_boxed(*chart_equations(chart, damped, side), chart.low, chart.high)

    def value(share):
        moved = move_within(boxes, skeleton, pose, chart, share * step)
        return frame_energy(body, moved, pairs, prior, weight)

    shares = jnp.asarray([*SHARES, 0.0], step.dtype)
    values = jnp.stack([value(share) for share in shares])
    share = best_share(shares, values)
    return move_within(boxes, skeleton, pose, chart, share * step), share


def best_share(shares: Float[Array, "N"], values: Float[Array, "N"]) -> Float[Array, ""]:
    """The share of a step of the least value; one that is worth no number is never the best, and no step is taken where
    all are."""
    values = jnp.where(jnp.isfinite(values), values, jnp.inf)
    return jnp.where(jnp.isfinite(values).any(), shares[jnp.argmin(values)], 0.0)
