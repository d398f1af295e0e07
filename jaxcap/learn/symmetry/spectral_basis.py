"""Eigenfunctions of a surface's Laplacian, and a signature of each vertex made of them."""

from typing import NamedTuple

import numpy as np
import scipy.sparse
from jaxtyping import Float
from scipy.sparse.linalg import eigsh

from .intrinsic_surface import IntrinsicSurface

#: the most eigenfunctions, and the least number of vertices for each
EIGENFUNCTIONS, VERTICES_PER_FUNCTION = 120, 4
#: shift of the factorised matrix below the least eigenvalue, which is zero
SHIFT = -1e-2
#: scales of the wave kernel signature, and its width in steps between scales
SCALES, WIDTH = 40, 7.0


class SpectralBasis(NamedTuple):
    """Eigenfunctions, orthonormal with respect to the areas of the vertices, in ascending order of eigenvalues."""

    functions: Float[np.ndarray, "V K"]
    eigenvalues: Float[np.ndarray, "K"]
    #: shares of the vertices in the area of the surface
    areas: Float[np.ndarray, "V"]


def make_spectral_basis(surface: IntrinsicSurface) -> SpectralBasis:
    """Compute the first eigenfunctions of the cotangent Laplacian."""
    areas = np.maximum(surface.areas, 1e-9 * surface.areas.mean())
    areas = areas / areas.sum()
    count = min(EIGENFUNCTIONS, surface.num_vertices // VERTICES_PER_FUNCTION)
    # a fixed first vector makes the result the same in every run
    start = np.random.default_rng(0).normal(size=surface.num_vertices)
    mass = scipy.sparse.diags_array(areas).tocsc()
    values, functions = eigsh(surface.laplacian.tocsc(), count, mass, sigma=SHIFT, v0=start)
    order = np.argsort(values)
    return SpectralBasis(functions[:, order], np.maximum(values[order], 0.0), areas)


def wave_kernel_signature(basis: SpectralBasis) -> Float[np.ndarray, "V N"]:
    """Compute the wave kernel signature, with zero mean and a total variance of one.

    It describes the shape around each vertex, such as that of the chest and the back, and does not change under a symmetry.

    **Source:** Aubry, Schlickewei and Cremers 2011, "The wave kernel signature".
    """
    logs = np.log(np.maximum(basis.eigenvalues[1:], 1e-12))
    scales = np.linspace(logs[0], logs[-1], SCALES)
    width = WIDTH * (scales[1] - scales[0])
    kernel = np.exp(-((scales[:, None] - logs) ** 2) / (2 * width**2))
    signature = basis.functions[:, 1:] ** 2 @ kernel.T / kernel.sum(1)
    return (signature - signature.mean(0)) / np.maximum(signature.std(0), 1e-12) / np.sqrt(SCALES)
