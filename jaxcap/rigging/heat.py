"""Smooth skinning weights by heat diffusion from the bones over the surface of a mesh."""

import numpy as np
import scipy.sparse as sparse
from jaxtyping import Float, Int

from ..body.influences import strongest_weights
from ..body.skeleton import Skeleton
from ..geometry.laplacian import cotangent_laplacian
from ..geometry.linear import factor_sparse
from ..geometry.mesh import vertex_areas, vertex_normals
from .envelopes import bone_distances, default_tails

#: largest number of bones per vertex
MAX_INFLUENCES = 4


def heat_weights(
    vertices: Float[np.ndarray, "V 3"],
    faces: Int[np.ndarray, "F 3"],
    skeleton: Skeleton,
    tails: Float[np.ndarray, "J 3"] | None = None,
    deforming: np.ndarray | None = None,
    heat: float = 1.0,
) -> Float[np.ndarray, "V J"]:
    """Compute bone heat weights (Baran and Popovic 2007, section 4): the equilibrium `-Lw + Hw = Hp`.

    `p_j` is one if bone `j` is a vertex's nearest, `H = heat / d^2` conducts heat from it over the distance
    `d`, and `L` diffuses it over the surface. A bone is visible only from vertices with a normal that points
    away from it; this replaces the paper's test by rays. Return weights of at most `MAX_INFLUENCES` bones per
    vertex; rows sum to one.

    **Arguments:** `tails (J, 3)` metres, `default_tails` if None; `deforming (J,)` of bool marks bones that
    move vertices, all if None; `heat`: the greater, the sharper the weights.
    """
    tails = default_tails(skeleton) if tails is None else tails
    distances, feet = bone_distances(vertices, np.asarray(skeleton.centres, float), tails)
    if deforming is not None:
        distances = np.where(deforming, distances, np.inf)
    laplacian, areas, normals = surface_operators(vertices, faces)
    outward = np.einsum("vja,va->vj", vertices[:, None] - feet, normals) >= 0
    seen = np.where(outward, distances, np.inf)
    seen = np.where(np.isfinite(seen).any(axis=1, keepdims=True), seen, distances)
    nearest = seen.min(axis=1)
    sources = seen <= 1.0001 * nearest[:, None]
    sources = sources / sources.sum(axis=1, keepdims=True)
    shortest = 1e-3 * float(np.ptp(vertices, axis=0).max())
    conduction = heat * areas / np.maximum(nearest, shortest) ** 2
    return prune_weights(_equilibrium(laplacian, conduction, sources))


def smooth_weights(
    vertices: Float[np.ndarray, "V 3"],
    faces: Int[np.ndarray, "F 3"],
    weights: Float[np.ndarray, "V J"],
    confidence: Float[np.ndarray, "V"],
    width: float,
) -> Float[np.ndarray, "V J"]:
    """Smooth weights over the surface by about `width` metres, in one implicit diffusion step.

    Return weights of at most `MAX_INFLUENCES` bones per vertex; rows sum to one.

    **Arguments:** `confidence (V,)` in a vertex's weights, from 0 to 1: a vertex of confidence zero takes
    its weights from the surface around it, at any distance.
    """
    laplacian, areas, _ = surface_operators(vertices, faces)
    # a small confidence everywhere keeps the system regular for components without any
    return prune_weights(_equilibrium(width**2 * laplacian, areas * np.maximum(confidence, 1e-4), weights))


def prune_weights(
    weights: Float[np.ndarray, "V J"], count: int = MAX_INFLUENCES, min_weight: float = 1e-3
) -> Float[np.ndarray, "V J"]:
    """Keep the `count` largest weights of every row, none below `min_weight`; rows sum to one again."""
    kept = weights >= np.minimum(min_weight, weights.max(axis=1, keepdims=True))
    return strongest_weights(np.where(kept, np.maximum(weights, 0.0), 0.0), count)


def surface_operators(
    vertices: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"]
) -> tuple[sparse.csc_matrix, Float[np.ndarray, "V"], Float[np.ndarray, "V 3"]]:
    """Compute the cotangent Laplacian (positive semidefinite), areas (m^2) and normals of vertices.

    The cotangents are clipped: the maximum principle holds, and heat stays between zero and one.
    """
    areas = vertex_areas(vertices, faces)
    areas = np.maximum(areas, 1e-6 * areas.mean())
    return sparse.csc_matrix(cotangent_laplacian(vertices, faces)), areas, vertex_normals(vertices, faces)


def _equilibrium(
    laplacian: sparse.csc_matrix, conduction: Float[np.ndarray, "V"], sources: Float[np.ndarray, "V J"]
) -> Float[np.ndarray, "V J"]:
    """Solve `(L + C) w = C s` for `w`, with one sparse factorisation for all bones."""
    system = factor_sparse(laplacian + sparse.diags(conduction))
    return system.solve(conduction[:, None] * sources)
