"""Bounded Levenberg-Marquardt over the traits of the embedded human and its pose together.

Traits bend at their middle states (MakeHuman's targets are linear between these), so their slopes are
taken over a short way.
"""

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy.linalg import cho_factor, cho_solve, cholesky, solve_triangular
from scipy.optimize import lsq_linear

from ..body.body import Body, pose_body
from ..body.human import shape_of
from ..body.morphs import AGES, Traits
from ..body.pose import Pose, retract
from ..body.skeleton import Skeleton
from ..energy.term import AbstractEnergy
from ..fit.problem import linearise

#: ranges of the traits, and how far people are from `USUAL` where nothing tells
LOWEST = Traits(0.0, AGES["child"], 0.0, 0.0, -1.0)
HIGHEST = Traits(1.0, AGES["old"], 1.0, 1.0, 1.0)
USUAL = Traits(0.5, 35.0, 0.5, 0.5, 0.0)
SPREAD = Traits(0.5, 20.0, 0.25, 0.25, 0.5)
#: share of a trait's range over which its slope is taken
REACH = 0.02
#: a step that lowers the squared deviations by no more is the last
ENOUGH = 1e-2
#: standard deviations of measured heights and lengths, metres
TAPE, LENGTH = 0.002, 0.003


class Measured(NamedTuple):
    """What was measured on the person: metres between pairs of joints (B, 2), and tall."""

    pairs: np.ndarray
    lengths: np.ndarray
    height: float | None


def descend(
    energy: AbstractEnergy | None,
    measured: Measured,
    numbers: np.ndarray,
    pose: Pose,
    free: tuple[int, ...],
    template: Body,
    resolution: str,
    steps: int,
) -> tuple[np.ndarray, Pose, np.ndarray]:
    """Traits, pose, and the covariance of the free traits and the pose."""
    low, high, usual, spread = (np.array(x, float) for x in (LOWEST, HIGHEST, USUAL, SPREAD))
    chosen = list(free)

    def residual(numbers, pose):
        body = _shaped(template, numbers, resolution)
        rows = [] if energy is None else [np.asarray(_residual(energy, body, pose), float)]
        return np.concatenate([*rows, _taken(measured, body), ((numbers - usual) / spread)[chosen]])

    def slopes(numbers, pose):
        jacobian = np.zeros((len(residual(numbers, pose)), len(chosen)))
        for column, number in enumerate(chosen):
            step = REACH * (high - low)[number] * np.eye(len(numbers))[number]
            ends = [np.clip(numbers + sign * step, low, high) for sign in (-1, 1)]
            jacobian[:, column] = residual(ends[1], pose) - residual(ends[0], pose)
            jacobian[:, column] /= (ends[1] - ends[0])[number]
        if energy is None:
            return jacobian
        by_pose = np.asarray(_slopes(energy, _shaped(template, numbers, resolution), pose), float)
        return np.hstack([jacobian, np.pad(by_pose, ((0, len(jacobian) - len(by_pose)), (0, 0)))])

    r, damping, count = residual(numbers, pose), 1e-3, len(chosen)
    for _ in range(steps):
        jacobian = slopes(numbers, pose)
        scale = np.append((high - low)[chosen], np.ones(jacobian.shape[1] - count))
        reached = None
        while damping < 1e6:
            ranges = (np.stack([low, high]) - numbers)[:, chosen] / scale[:count]
            step = scale * _bounded_step(jacobian * scale, r, damping, ranges)
            there = numbers.copy()
            there[chosen] = np.clip(there[chosen] + step[:count], low[chosen], high[chosen])
            moved = pose if energy is None else _moved(template, pose, step[count:])
            after = residual(there, moved)
            if after @ after < r @ r:
                reached = there, moved, after
                break
            damping *= 10.0
        if reached is None:
            break
        fell = r @ r - reached[2] @ reached[2]
        numbers, pose, r = reached
        damping = max(damping / 10.0, 1e-6)
        if fell < ENOUGH:
            break
    jacobian = slopes(numbers, pose)
    return numbers, pose, np.linalg.pinv(jacobian.T @ jacobian, hermitian=True)


def _bounded_step(jacobian: np.ndarray, r: np.ndarray, damping: float, ranges: np.ndarray) -> np.ndarray:
    """The damped step of least squares, its first numbers within `ranges (2, T)`: the others are
    eliminated, which leaves a bounded problem of T numbers."""
    count = ranges.shape[1]
    normal = jacobian.T @ jacobian + damping * np.eye(jacobian.shape[1])
    gradient = jacobian.T @ r
    inner = cho_factor(normal[count:, count:]) if count < len(gradient) else None
    if inner is None:
        across, rest = np.zeros((0, count)), np.zeros(0)
    else:
        across, rest = cho_solve(inner, normal[count:, :count]), cho_solve(inner, gradient[count:])
    if not count:
        return -rest
    reduced = normal[:count, :count] - normal[:count, count:] @ across
    root = cholesky(reduced)
    right = solve_triangular(root, normal[:count, count:] @ rest - gradient[:count], trans=1)
    # a bound met to the last digit leaves the search no inside
    first = lsq_linear(root, right, (ranges[0], np.maximum(ranges[1], ranges[0] + 1e-12))).x
    return np.append(first, -rest - across @ first)


def _shaped(template: Body, numbers: np.ndarray, resolution: str) -> Body:
    """The template as another person; the frames in which its joints' own angles are measured stay."""
    vertices, ends = shape_of(Traits(*numbers), resolution)
    dtype = template.vertices.dtype
    arrays = jnp.asarray(vertices, dtype), jnp.asarray(ends[:, 0], dtype)
    return eqx.tree_at(lambda b: (b.vertices, b.skeleton.centres), template, arrays)


def _taken(measured: Measured, body: Body) -> np.ndarray:
    """How far what was measured on the person is from what the body has, in deviations."""
    centres = np.asarray(body.skeleton.centres, float)
    apart = np.linalg.norm(centres[measured.pairs[:, 0]] - centres[measured.pairs[:, 1]], axis=1)
    rows = (apart - measured.lengths) / LENGTH
    if measured.height is None:
        return rows
    return np.append(rows, (np.ptp(np.asarray(body.vertices, float)[:, 1]) - measured.height) / TAPE)


@eqx.filter_jit
def _residual(energy: AbstractEnergy, body: Body, pose: Pose) -> Float[Array, "R"]:
    return energy.residual(pose_body(body, pose))


@eqx.filter_jit
def _slopes(energy: AbstractEnergy, body: Body, pose: Pose) -> Float[Array, "R D"]:
    return linearise(energy, body, pose)[1]


@eqx.filter_jit
def _retract(skeleton: Skeleton, pose: Pose, step: Float[Array, "D"]) -> Pose:
    return retract(skeleton, pose, step)


def _moved(body: Body, pose: Pose, step: np.ndarray) -> Pose:
    return _retract(body.skeleton, pose, jnp.asarray(step, pose.rotations.dtype))
