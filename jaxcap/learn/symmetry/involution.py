"""Maps that are their own inverse, as matrices between eigenfunctions.

A symmetry of a surface acts on functions by composition. In an orthonormal basis of eigenfunctions this is a matrix that
is orthogonal, as areas are kept, and its own inverse, as a reflection is: symmetric with eigenvalues 1 and -1. Even
functions have eigenvalue 1, odd functions -1. Functions whose images are not among the first eigenfunctions have eigenvalue
0: their sign is not known.
"""

import numpy as np
from jaxtyping import Float, Int

from .point_map import nearest_rows
from .spectral_basis import SpectralBasis

#: eigenfunctions with which refinement begins, and those added in each step
FIRST, STEP = 12, 6
#: steps at the end with all eigenfunctions
LAST_STEPS = 3
#: least absolute eigenvalue of a function that is even or odd
MIN_PARITY = 0.3


def refine_involution(
    basis: SpectralBasis, images: Int[np.ndarray, "V"], most: int
) -> Float[np.ndarray, "K K"]:
    """Refine a map of vertices to vertices by adding eigenfunctions step by step, up to `most`.

    The map is converted to the nearest involution between the first eigenfunctions, and this back to a map by nearest
    neighbours. Returns the involution.

    **Source:** Melzi et al. 2019, "ZoomOut: spectral upsampling for efficient shape correspondence"; the involution is ours.
    """
    most = min(most, basis.functions.shape[1])
    matrix = np.eye(most)
    for count in [*range(min(FIRST, most), most, STEP), *([most] * LAST_STEPS)]:
        functions = basis.functions[:, :count]
        matrix = nearest_involution(functions.T @ (basis.areas[:, None] * functions[images]))
        images = nearest_rows(*embeddings(functions, matrix))
    return matrix


def embeddings(
    functions: Float[np.ndarray, "V K"], involution: Float[np.ndarray, "K K"]
) -> tuple[Float[np.ndarray, "V K"], Float[np.ndarray, "V K"]]:
    """Compute coordinates of the images of vertices, and of the vertices, in the functions whose parity is known."""
    images = functions @ involution
    return images, images @ involution


def nearest_involution(matrix: Float[np.ndarray, "K K"]) -> Float[np.ndarray, "K K"]:
    """Compute the nearest symmetric matrix with eigenvalues 1 and -1, and 0 where the parity is not known."""
    values, vectors = np.linalg.eigh((matrix + matrix.T) / 2)
    parities = np.where(np.abs(values) < MIN_PARITY, 0.0, np.sign(values))
    return (vectors * parities) @ vectors.T


def smoothest_odd_function(
    basis: SpectralBasis, involution: Float[np.ndarray, "K K"]
) -> Float[np.ndarray, "V"]:
    """Compute the odd function with the least Dirichlet energy; its sign distinguishes the two sides.

    It is the first eigenfunction of one half with zeros on the middle, which has no other zeros (Courant).
    """
    count = len(involution)
    values, vectors = np.linalg.eigh(involution)
    odd = vectors[:, values < -0.5]
    if odd.shape[1] == 0:
        return np.zeros(len(basis.functions))
    energies = odd.T @ (basis.eigenvalues[:count, None] * odd)
    return basis.functions[:, :count] @ (odd @ np.linalg.eigh(energies)[1][:, 0])
