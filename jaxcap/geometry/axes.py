"""Coordinate axes nearest to directions and rotations, for up, left and front directions."""

import numpy as np
from jaxtyping import Float


def nearest_axis(vector: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
    """Find the signed coordinate axis nearest to a vector; zero for the zero vector."""
    largest = int(np.argmax(np.abs(vector)))
    return np.sign(vector[largest]) * np.eye(3)[largest]


def nearest_signed_permutation(matrix: Float[np.ndarray, "3 3"]) -> Float[np.ndarray, "3 3"]:
    """Find the signed permutation matrix nearest to a rotation, greedily by the largest entries.

    It is a reflection where the matrix is one.
    """
    turn, remaining = np.zeros((3, 3)), np.abs(matrix)
    for _ in range(3):
        row, column = np.unravel_index(np.argmax(remaining), (3, 3))
        turn[row, column] = np.sign(matrix[row, column])
        remaining[row, :] = remaining[:, column] = -1.0
    return turn
