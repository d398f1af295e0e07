"""Fit linear blend weights of vertices over few candidate bones each to target positions."""

import numpy as np
from jaxtyping import Bool, Float, Int

from ...fit.linear_solvers.float64 import in_float64
from ...fit.solvers.simplex_least_squares import simplex_least_squares
from ...geometry.linear import inverse_symmetric

#: vertices per block, to bound memory
_BLOCK = 1024


def fit_linear_weights(
    vertices: Float[np.ndarray, "V 3"],
    targets: Float[np.ndarray, "F V 3"],
    frames: Float[np.ndarray, "F B 3 4"],
    candidates: Int[np.ndarray, "V K"],
    influences: int,
) -> tuple[Float[np.ndarray, "V K"], Float[np.ndarray, "V"]]:
    """Fit the weights of each vertex's candidate bones; also return its largest distance from its targets,
    metres.

    **Arguments:** `frames` are `[R | t]` of all bones in every frame; `candidates` index them, -1 if a vertex
    has fewer.

    Weights minimise the least-squares error subject to being non-negative and of sum one, at most
    `influences` of them: the one that is missed least is dropped and the rest fitted again until this holds.
    """
    weights, errors = np.zeros(candidates.shape), np.zeros(len(vertices))
    for start in range(0, len(vertices), _BLOCK):
        part = slice(start, start + _BLOCK)
        chosen = candidates[part]
        bones = frames[:, np.maximum(chosen, 0)]
        offsets = np.einsum("fvkab,vb->vkfa", bones[..., :3], vertices[part]) + bones[..., 3].transpose(
            1, 2, 0, 3
        )
        # from the targets: as weights sum to one, the error of a blend is the blend of these
        offsets -= targets[:, None, part].transpose(2, 1, 0, 3)
        offsets = offsets.reshape(*chosen.shape, -1)
        weights[part] = _fit_simplex_weights(offsets, chosen >= 0, influences)
        missed = np.einsum("vkf,vk->vf", offsets, weights[part]).reshape(len(chosen), -1, 3)
        errors[part] = np.linalg.norm(missed, axis=2).max(1)
    return weights, errors


def blend_errors(
    vertices: Float[np.ndarray, "V 3"],
    targets: Float[np.ndarray, "F V 3"],
    frames: Float[np.ndarray, "F B 3 4"],
    candidates: Int[np.ndarray, "V K"],
    weights: Float[np.ndarray, "V K"],
) -> Float[np.ndarray, "F V"]:
    """Compute the distances of blended vertices from their targets, metres; arguments as in
    `fit_linear_weights`."""
    errors = np.zeros(targets.shape[:2])
    for start in range(0, len(vertices), _BLOCK):
        part = slice(start, start + _BLOCK)
        blended = np.einsum("fvkab,vk->fvab", frames[:, np.maximum(candidates[part], 0)], weights[part])
        posed = np.einsum("fvab,vb->fva", blended[..., :3], vertices[part]) + blended[..., 3]
        errors[:, part] = np.linalg.norm(posed - targets[:, part], axis=2)
    return errors


def _fit_simplex_weights(
    offsets: Float[np.ndarray, "V K R"], allowed: Bool[np.ndarray, "V K"], influences: int
) -> Float[np.ndarray, "V K"]:
    missing = _BLOCK - len(offsets)
    gram = np.pad(offsets @ offsets.transpose(0, 2, 1), ((0, missing), (0, 0), (0, 0)))
    allowed = np.pad(allowed, ((0, missing), (0, 0)))
    allowed[len(offsets) :, 0] = True
    weights = allowed / allowed.sum(1, keepdims=True)
    while True:
        weights = np.array(in_float64(simplex_least_squares, gram, np.zeros(weights.shape), weights, allowed))
        many = (weights > 0).sum(1) > influences
        if not many.any():
            return weights[: len(offsets)]
        allowed = (weights > 0) | (allowed & ~many[:, None])
        allowed[many, _removal_costs(gram[many], weights[many]).argmin(1)] = False
        weights = np.where(allowed, weights, 0.0)
        weights /= weights.sum(1, keepdims=True)


def _removal_costs(
    gram: Float[np.ndarray, "V K K"], weights: Float[np.ndarray, "V K"]
) -> Float[np.ndarray, "V K"]:
    """Compute how much the squared error rises if a weight becomes zero and the others adjust; infinite for weights of zero.

    Of two bones that move alike, either can be dropped without an error, however large its weight is.
    """
    used = weights > 0
    sizes = np.einsum("vkk->vk", gram)
    ridge = 1e-12 * sizes.max(1, keepdims=True) + 1e-30
    matrix = np.where(used[:, :, None] & used[:, None], gram, 0.0)
    matrix = matrix + np.eye(used.shape[1]) * np.where(used, ridge, 1.0)[:, None]
    inverse = inverse_symmetric(matrix)
    # weights keep their sum
    sums = np.where(used, (inverse * used[:, None]).sum(2), 0.0)
    spread = np.einsum("vkk->vk", inverse) - sums**2 / np.maximum(
        sums.sum(1, keepdims=True), np.finfo(float).tiny
    )
    return np.where(used, weights**2 / np.maximum(spread, np.finfo(float).tiny), np.inf)
