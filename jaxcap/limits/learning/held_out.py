"""Folds of samples for cross-validation: people, takes or blocks that are left out as a whole."""

from typing import Literal

import numpy as np
from jaxtyping import Float, Int

from ...errors import InputError
from .samples import JointSamples

HeldOut = Literal["people", "takes", "blocks"]
#: number of folds over blocks
FOLDS = 5
#: indices of training and test samples
Fold = tuple[Int[np.ndarray, "_"], Int[np.ndarray, "_"]]


def widest_held_out(samples: JointSamples) -> HeldOut:
    """Return the largest unit of which there are several: people, else takes, else blocks of one take."""
    if samples.people is not None and len(np.unique(samples.people)) > 1:
        return "people"
    if samples.takes is not None and len(np.unique(samples.takes)) > 1:
        return "takes"
    return "blocks"


def make_folds(samples: JointSamples, held_out: HeldOut) -> list[Fold]:
    """Split samples into folds, one for each person or take, or five over blocks.

    A capture with fewer blocks is cut into five.

    **Raises:** `InputError` where there are not several people or takes.
    """
    if held_out == "blocks":
        return block_folds(samples.blocks)
    groups = samples.people if held_out == "people" else samples.takes
    count = 0 if groups is None else len(np.unique(groups))
    if groups is None or count < 2:
        raise InputError(
            f"The samples are of {count or 'an unknown number of'} {held_out}, so none can be left out; give several, or leave out blocks."
        )
    return [(np.flatnonzero(groups != one), np.flatnonzero(groups == one)) for one in np.unique(groups)]


def block_folds(blocks: Int[np.ndarray, "F"]) -> list[Fold]:
    """Split frames into five folds by blocks."""
    order = np.unique(blocks, return_inverse=True)[1]
    if order.max() + 1 < FOLDS:
        order = np.arange(len(blocks)) * FOLDS // len(blocks)
    held_out = [order % FOLDS == fold for fold in range(FOLDS)]
    return [(np.flatnonzero(~out), np.flatnonzero(out)) for out in held_out]


def mean_quantile(folds: list[Float[np.ndarray, "_"]], share: float) -> float:
    """Compute the smallest value that the mean over folds of the share of values below it reaches."""
    values = np.concatenate(folds)
    weights = np.concatenate([np.full(len(each), 1 / (len(each) * len(folds))) for each in folds])
    order = np.argsort(values)
    reached = np.cumsum(weights[order])
    return float(values[order][min(np.searchsorted(reached, share - 1e-9), len(order) - 1)])
