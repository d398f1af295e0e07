"""Directions of displacements as products of low rank, one for each joint."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from ...geometry.linear import low_rank_factors

#: share of the mean square of a joint's values that is added to each of them, as those of hinges are dependent
MIN_VARIANCE = 1e-4
#: share of the product of the largest value and all directions below which a unit moves nothing in the poses
MIN_UNIT = 1e-6


class LowRankDirections(NamedTuple):
    """Directions `D = U C`: each row of `C` combines the values of one joint into a unit, and `U` are its displacements."""

    directions: Float[np.ndarray, "V 3 K"]
    layer: Float[np.ndarray, "K P"]
    #: the joint of each unit
    joints: Int[np.ndarray, "K"]


def factorise_by_joint(
    directions: Float[np.ndarray, "V 3 P"],
    values: Float[np.ndarray, "F P"],
    joints: Int[np.ndarray, "P"],
    rank: int,
) -> LowRankDirections:
    """Approximate the directions of each joint by at most `rank` units.

    Units are scaled so that the largest absolute value in the poses is one: their directions are then the displacements
    at that value, metres. Joints without values other than zero, or without directions, have no units, and units that move
    nothing in the poses are left out.

    **Arguments:** `values` by which the directions are multiplied in the poses; `joints` are those of the values.
    """
    lefts, rows = [np.zeros((len(directions), 3, 0))], [np.zeros((0, len(joints)))]
    owners = [np.zeros(0, int)]
    for joint in np.unique(joints):
        columns = np.flatnonzero(joints == joint)
        own = np.asarray(values[:, columns], float)
        block = np.asarray(directions[:, :, columns], float).reshape(-1, len(columns))
        variance = float(np.mean(own**2))
        if not variance > 0 or not block.any():
            continue
        metric = own.T @ own / len(own) + MIN_VARIANCE * variance * np.eye(len(columns))
        left, right = low_rank_factors(block, metric, rank)
        largest = np.abs(own @ right.T).max(0)
        moves = largest * np.linalg.norm(left, axis=0) > MIN_UNIT * np.abs(own).max() * np.linalg.norm(block)
        left, right, largest = left[:, moves], right[moves], largest[moves]
        layer = np.zeros((len(right), len(joints)))
        layer[:, columns] = right / largest[:, None]
        lefts.append((left * largest).reshape(len(directions), 3, -1))
        rows.append(layer)
        owners.append(np.full(len(layer), joint))
    return LowRankDirections(np.concatenate(lefts, 2), np.concatenate(rows), np.concatenate(owners))
