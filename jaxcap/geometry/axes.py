"""Coordinate axes that are near to directions and turns: up, left and front of what stands along them."""

import numpy as np
from jaxtyping import Float


def nearest_axis(vector: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
    """The coordinate axis that a vector goes along most, with its sign; zero for a vector without length."""
    largest = int(np.argmax(np.abs(vector)))
    return np.sign(vector[largest]) * np.eye(3)[largest]


def nearest_turn(matrix: Float[np.ndarray, "3 3"]) -> Float[np.ndarray, "3 3"]:
    """Each coordinate axis onto one of them, with its sign, as a rotation goes most, largest parts first; a mirror
    where that is one."""
    turn, remaining = np.zeros((3, 3)), np.abs(matrix)
    for _ in range(3):
        row, column = np.unravel_index(np.argmax(remaining), (3, 3))
        turn[row, column] = np.sign(matrix[row, column])
        remaining[row, :] = remaining[:, column] = -1.0
    return turn
