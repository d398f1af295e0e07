"""The poses of all frames eliminated from a least-squares problem with shared unknowns.

The same block-arrow system as `jaxcap.fit.arrow`, in plain NumPy and float64 whatever the input: what
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


def eliminate(rows: Rows, poses: Drawn) -> Reduced:
    """The reduced equations: `C - sum_f B_f^T A_f^-1 B_f`, by one Cholesky factor a frame; `poses`
    is a prior of theirs."""
    wide, own, residual = (np.asarray(x) for x in (rows.wide, rows.own, rows.residual))
    frames, markers, _, numbers = wide.shape
    dofs = poses.side.shape[1]
    centres = numbers - dofs
    size = centres + 3 * markers
    upper = np.zeros((size, size))
    side, gain = np.zeros(size), 0.0
    slopes, offsets = np.zeros((frames, dofs, size)), np.zeros((frames, dofs))
    block = np.arange(markers)
    for frame in range(frames):
        flat = wide[frame].reshape(3 * markers, numbers).astype(float)
        tall, ends = residual[frame].ravel().astype(float), own[frame].astype(float)
        gram = flat.T @ flat
        # (N, M, 3): every row times the 3 x 3 block of its marker
        across = np.matmul(flat.T.reshape(numbers, markers, 1, 3).transpose(1, 0, 2, 3)[:, :, 0], ends)
        across = across.transpose(1, 0, 2).reshape(numbers, -1)
        upper[:centres, :centres] += gram[dofs:, dofs:]
        upper[:centres, centres:] += across[dofs:]
        diagonal = upper[centres:, centres:].reshape(markers, 3, markers, 3)
        diagonal[block, :, block] += np.matmul(ends.transpose(0, 2, 1), ends)
        pull = -(flat.T @ tall)
        pull[:dofs] += poses.side[frame]
        side[:centres] += pull[dofs:]
        side[centres:] -= np.matmul(ends.transpose(0, 2, 1), tall.reshape(markers, 3, 1)).ravel()
        factor = np.linalg.cholesky(gram[:dofs, :dofs] + poses.matrix[frame] + RIDGE * np.eye(dofs))
        coupling = np.hstack([gram[:dofs, dofs:], across[:dofs], pull[:dofs, None]])
        half = scipy.linalg.solve_triangular(factor, coupling, lower=True, check_finite=False)
        upper -= half[:, :-1].T @ half[:, :-1]
        side -= half[:, :-1].T @ half[:, -1]
        gain += float(half[:, -1] @ half[:, -1])
        whole = scipy.linalg.solve_triangular(factor, half, lower=True, trans=1, check_finite=False)
        slopes[frame], offsets[frame] = whole[:, :-1], whole[:, -1]
    lower = np.tril_indices(size, -1)
    upper[lower] = upper.T[lower]
    return Reduced(upper, side, slopes, offsets, gain)


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
