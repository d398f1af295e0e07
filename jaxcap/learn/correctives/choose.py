"""The strength of the prior and the rank of correctives, chosen by the errors of left-out poses."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int

from ...body.skin.low_rank import factorise_by_joint
from .equations import CorrectiveEquations, solve_left_out

#: candidates of the prior's strength: the number of meshes with a feature of one that weigh as much as the prior
STRENGTHS = (0.1, 0.3, 1.0, 3.0, 10.0)
#: candidates of the largest rank of a joint's displacements
RANKS = (1, 2, 3, 4, 6, 9)
#: folds of successive meshes, each left out once
NUM_FOLDS = 5
#: a lower rank and a stronger prior are chosen if the error is larger by at most this share
TOLERANCE = 0.01


class CorrectiveChoice(NamedTuple):
    """The chosen strength and rank, with the errors of poses that were left out: root mean squares over vertices, metres."""

    strength: float
    rank: int
    #: by strength and rank, for the candidates `STRENGTHS` and `RANKS`
    errors: Float[np.ndarray, "S R"]
    #: of each mesh, without correctives and with the chosen ones
    errors_without: Float[np.ndarray, "F"]
    errors_with: Float[np.ndarray, "F"]
    #: whether correctives lower the mean squared error by more than one standard error over the folds
    is_gain: bool

    @property
    def error_without(self) -> float:
        """The root mean square error of left-out poses without correctives, metres."""
        return float(np.sqrt(np.mean(self.errors_without**2)))

    @property
    def error_with(self) -> float:
        """The root mean square error of left-out poses with the chosen correctives, metres."""
        return float(np.sqrt(np.mean(self.errors_with**2)))


def successive_folds(count: int, num_folds: int) -> Int[np.ndarray, "F"]:
    """Divide meshes into folds of successive ones: neighbours in a motion are alike, and do not test each other."""
    return np.arange(count) * num_folds // count


def choose_correctives(
    equations: CorrectiveEquations, joints: Int[np.ndarray, "K"], num_folds: int = NUM_FOLDS
) -> CorrectiveChoice:
    """Choose the strength of the prior and the rank by cross-validation over folds of successive meshes.

    The error of a left-out mesh without correctives is that with a shape at rest from the same meshes.

    **Arguments:** `joints`, the joint of each unit of the equations.
    """
    values = np.asarray(equations.values, float)
    folds = successive_folds(len(values), num_folds)
    kept = folds != np.arange(num_folds)[:, None]
    dtype = equations.errors.dtype
    shifts, directions, plain = (
        np.asarray(part, float)
        for part in solve_left_out(equations, jnp.asarray(STRENGTHS, dtype), jnp.asarray(kept, dtype))
    )
    squares = np.zeros((len(STRENGTHS), len(RANKS), len(values)))
    without = np.zeros(len(values))
    for fold in range(num_folds):
        out = ~kept[fold]
        without[out] = _mean_squares(equations, out, plain[:, fold])
        for s in range(len(STRENGTHS)):
            for r, rank in enumerate(RANKS):
                found = factorise_by_joint(directions[:, fold, s], values[kept[fold]], joints, rank)
                units = values[out] @ found.layer.T
                moved = np.tensordot(units, found.directions, (1, 2)) + shifts[:, fold, s]
                squares[s, r, out] = _mean_squares(equations, out, moved)
    s, r = _simplest(squares.mean(2))
    gains = np.array([np.mean((without - squares[s, r])[folds == fold]) for fold in range(num_folds)])
    deviation = gains.std(ddof=1) / np.sqrt(num_folds)
    return CorrectiveChoice(
        STRENGTHS[s],
        RANKS[r],
        np.sqrt(squares.mean(2)),
        np.sqrt(without),
        np.sqrt(squares[s, r]),
        bool(gains.mean() > deviation),
    )


def _mean_squares(
    equations: CorrectiveEquations, meshes: Bool[np.ndarray, "F"], moved: Float[np.ndarray, "*G V 3"]
) -> Float[np.ndarray, "H"]:
    """Compute the mean squared residual of some meshes with displacements of the vertices at rest."""
    slopes, errors = (np.asarray(part)[meshes] for part in (equations.slopes, equations.errors))
    gaps = errors - (slopes @ np.broadcast_to(moved, errors.shape)[..., None])[..., 0]
    return np.mean(np.sum(gaps**2, 2), 1)


def _simplest(means: Float[np.ndarray, "S R"]) -> tuple[int, int]:
    """Find the lowest rank, and for it the strongest prior, with nearly the least error."""
    good = np.sqrt(means) <= (1 + TOLERANCE) * np.sqrt(means.min())
    r = int(np.flatnonzero(good.any(0))[0])
    return int(np.flatnonzero(good[:, r])[-1]), r
