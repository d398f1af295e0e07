"""The poses of all frames eliminated from a least-squares problem with shared unknowns.

The same block-arrow system as `jaxcap.fit.solvers.block_arrow`, in plain NumPy and float64 whatever the input: what
frames tell of the shared unknowns is a difference of large numbers, and directions that are hardly told
drown in float32. A marker's rest place enters its own residuals only, so its columns are 3 x 3 blocks.
"""

from typing import NamedTuple

import numpy as np
import scipy.linalg
from jaxtyping import Float

from .equations import Rows
from .turning import Drawn

#: information on every number of a pose, 1/radian^2 and 1/metre^2: what no marker shows stays
RIDGE = 1.0
#: frames that are eliminated at once
BATCH = 16


class Reduced(NamedTuple):
    """Normal equations `matrix s = side` of the shared unknowns, the frames' own numbers being free."""

    matrix: Float[np.ndarray, "S S"]
    side: Float[np.ndarray, "S"]
    #: of each frame, by which its pose follows: `offset - slope @ s`
    slopes: Float[np.ndarray, "F D S"]
    offsets: Float[np.ndarray, "F D"]
    #: what all poses gain where nothing shared moves
    gain: float

    def with_prior(self, precision: Float[np.ndarray, "S S"], away: Float[np.ndarray, "S"]) -> "Reduced":
        """The same with a normal prior, from whose mean the shared unknowns are `away`."""
        return self._replace(matrix=self.matrix + precision, side=self.side - precision @ away)

    def step(
        self, damping: float, constraints: Float[np.ndarray, "C S"], violation: Float[np.ndarray, "C"]
    ) -> tuple[Float[np.ndarray, "S"], Float[np.ndarray, "F D"]]:
        """The shared step, damped after Marquardt, with `constraints s = violation`, and the poses'."""
        shared = constrained(self.matrix, self.side, damping, constraints, violation)
        return shared, self.offsets - self.slopes @ shared

    def decrease(self, shared: Float[np.ndarray, "S"]) -> float:
        """By how much the squares fall with a step if the problem is linear."""
        return float(self.gain + 2 * self.side @ shared - shared @ self.matrix @ shared)


def eliminate(rows: Rows, poses: Drawn, features: Float[np.ndarray, "F M K"]) -> Reduced:
    """The reduced equations: `C - sum_f B_f^T A_f^-1 B_f`; `poses` is a prior of theirs.

    By K `features` each marker has as many more triples of unknowns, behind all rest places, by which
    its rest place shifts with the frame's features (`jaxcap.markers.skin`)."""
    frames, markers, _, numbers = rows.wide.shape
    dofs, triples = poses.side.shape[1], 1 + features.shape[2]
    centres = numbers - dofs
    size = centres + 3 * markers * triples
    matrix, side, gain = np.zeros((size, size)), np.zeros(size), 0.0
    slopes, offsets = np.zeros((frames, dofs, size)), np.zeros((frames, dofs))
    wide, own, residual = (np.asarray(x) for x in (rows.wide, rows.own, rows.residual))
    for first in range(0, frames, BATCH):
        some = slice(first, first + BATCH)
        flat = wide[some].reshape(-1, 3 * markers, numbers).astype(float)
        tall, ends = residual[some].astype(float), own[some].astype(float)
        shares = np.concatenate([np.ones((len(flat), markers, 1)), features[some]], 2)
        turned = np.swapaxes(flat, 1, 2)
        gram = turned @ flat
        # (f, m, N, 3): every row times the 3 x 3 block of its marker
        blocks = np.swapaxes(turned.reshape(len(flat), numbers, markers, 3), 1, 2) @ ends
        across = np.einsum("fmna,fmt->fntma", blocks, shares).reshape(len(flat), numbers, -1)
        pull = -(turned @ tall.reshape(len(flat), -1, 1))[..., 0]
        pull[:, :dofs] += poses.side[some]
        matrix[:centres, :centres] += gram[:, dofs:, dofs:].sum(0)
        matrix[:centres, centres:] += across[:, dofs:].sum(0)
        _add_own(matrix[centres:, centres:], ends, shares)
        side[:centres] += pull[:, dofs:].sum(0)
        by_own = (np.swapaxes(ends, 2, 3) @ tall[..., None])[..., 0]
        side[centres:] -= np.einsum("fma,fmt->tma", by_own, shares).ravel()
        held = gram[:, :dofs, :dofs] + poses.matrix[some] + RIDGE * np.eye(dofs)
        inverse = np.linalg.inv(np.linalg.cholesky(held))
        coupling = np.concatenate([gram[:, :dofs, dofs:], across[:, :dofs], pull[:, :dofs, None]], 2)
        half = inverse @ coupling
        whole = np.swapaxes(inverse, 1, 2) @ half
        half = half.reshape(-1, size + 1)
        matrix -= half[:, :-1].T @ half[:, :-1]
        side -= half[:, :-1].T @ half[:, -1]
        gain += float(half[:, -1] @ half[:, -1])
        slopes[some], offsets[some] = whole[..., :-1], whole[..., -1]
    lower = np.tril_indices(size, -1)
    matrix[lower] = matrix.T[lower]
    return Reduced(matrix, side, slopes, offsets, gain)


def _add_own(corner: Float[np.ndarray, "O O"], ends, shares) -> None:
    """The squares of what is a marker's own, which no other marker shares."""
    markers, triples = shares.shape[1:]
    block, view = np.arange(markers), corner.reshape(triples, markers, 3, triples, markers, 3)
    squares = np.swapaxes(ends, 2, 3) @ ends
    # NumPy puts the one index of both picked axes first
    view[:, block, :, :, block, :] += np.einsum("fmab,fmt,fmu->mtaub", squares, shares, shares, optimize=True)


def pose_steps(rows: Rows, poses: Drawn) -> Float[np.ndarray, "F D"]:
    """The step of each frame's pose where nothing shared moves."""
    flat, matrix = _of_poses(rows, poses)
    tall = np.asarray(rows.residual, float).reshape(len(flat), -1)
    side = poses.side - np.einsum("frd,fr->fd", flat, tall)
    return np.linalg.solve(matrix, side[..., None])[..., 0]


def pose_covariances(rows: Rows, poses: Drawn) -> Float[np.ndarray, "F D D"]:
    """The covariance of each frame's pose where what is shared is known."""
    return np.linalg.inv(_of_poses(rows, poses)[1])


def _of_poses(rows: Rows, poses: Drawn) -> tuple[np.ndarray, np.ndarray]:
    dofs = poses.side.shape[1]
    flat = np.asarray(rows.wide)[..., :dofs].astype(float)
    flat = flat.reshape(len(flat), -1, dofs)
    return flat, np.swapaxes(flat, 1, 2) @ flat + poses.matrix + RIDGE * np.eye(dofs)


def constrained(
    matrix: Float[np.ndarray, "S S"],
    side: Float[np.ndarray, "S"],
    damping: float,
    constraints: Float[np.ndarray, "C S"],
    violation: Float[np.ndarray, "C"],
) -> Float[np.ndarray, "S"]:
    """`argmin s^T M s / 2 - side^T s` with `constraints s = violation`, which may depend on each other,
    and Marquardt's damping of `M`."""
    scale = 1.0 / np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    even = matrix * scale[:, None] * scale + (damping + 1e-13 * len(matrix)) * np.eye(len(matrix))
    factor = scipy.linalg.cho_factor(even, lower=True, check_finite=False)
    free = scipy.linalg.cho_solve(factor, scale * side, check_finite=False)
    if len(constraints) == 0:
        return scale * free
    rows = constraints * scale
    answers = scipy.linalg.cho_solve(factor, rows.T, check_finite=False)
    multipliers = np.linalg.lstsq(rows @ answers, rows @ free - violation, rcond=1e-11)[0]
    return scale * (free - answers @ multipliers)
