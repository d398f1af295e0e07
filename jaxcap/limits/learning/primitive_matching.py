"""Matching of the primitives of two shapes for interpolation between them."""

import numpy as np
from jaxtyping import Float, Int
from scipy.optimize import linear_sum_assignment
from scipy.spatial import KDTree


def match_primitives(
    centres: Float[np.ndarray, "N 3"],
    thickness: Float[np.ndarray, "N"],
    other_centres: Float[np.ndarray, "M 3"],
    other_thickness: Float[np.ndarray, "M"],
) -> Int[np.ndarray, "N"]:
    """Match each of N primitives to one of M others, M at most N (Limits, section 4.2).

    First each of the M others gets one of the N, with the least sum of distances. Each remaining primitive
    takes its closest.

    The distance is that of eq. 3, but with the difference of thickness squared, too. As printed it is
    signed, and a primitive would be close because it is thinner.

    **Raises:** `ValueError` where there are more others than primitives.
    """
    if len(other_centres) > len(centres):
        raise ValueError(
            f"{len(centres)} primitives cannot be matched to {len(other_centres)} others; expected at most as many "
            "others as primitives; swap the two sets."
        )
    mine = np.column_stack([centres, thickness])
    others = np.column_stack([other_centres, other_thickness])
    nearest_distances, closest = KDTree(others).query(mine)
    chosen = np.asarray(closest, int)
    # primitives that coincide, as on one grid, match
    same = np.flatnonzero(np.asarray(nearest_distances) == 0.0)
    _, first = np.unique(chosen[same], return_index=True)
    taken = same[first]
    rest = np.setdiff1d(np.arange(len(others)), chosen[taken])
    free = np.setdiff1d(np.arange(len(mine)), taken)
    if len(rest):
        distances = np.sum((mine[free][:, None] - others[rest][None]) ** 2, -1)
        rows, columns = linear_sum_assignment(distances)
        chosen[free[rows]] = rest[columns]
    return chosen
