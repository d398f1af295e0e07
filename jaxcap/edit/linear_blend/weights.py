"""Fit linear blend weights of vertices over few candidate bones each to target positions."""

import numpy as np
from jaxtyping import Float, Int
from scipy.optimize import nnls

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
    `influences` of them: the smallest is dropped and the rest fitted again until this holds. As the weights
    sum to one, `sum w x - y` is `sum w (x - y)`, so with `D` the offsets of the candidates from the target,
    the solution of `min |D w|^2 + (sum w - 1)^2, w >= 0` divided by its sum is that of `min |D w|^2` on the
    simplex: along each ray the best value is `|D u|^2 / (1 + |D u|^2)`.
    """
    weights, errors = np.zeros(candidates.shape), np.zeros(len(vertices))
    for start in range(0, len(vertices), _BLOCK):
        part = slice(start, start + _BLOCK)
        chosen = candidates[part]
        bones = frames[:, np.maximum(chosen, 0)]
        offsets = np.einsum("fvkab,vb->vkfa", bones[..., :3], vertices[part]) + bones[..., 3].transpose(
            1, 2, 0, 3
        )
        offsets -= targets[:, None, part].transpose(2, 1, 0, 3)
        offsets = offsets.reshape(*chosen.shape, -1).transpose(0, 2, 1)
        # millimetres, to scale them against the row of ones
        system = np.concatenate([1e3 * offsets, np.ones((len(chosen), 1, chosen.shape[1]))], 1)
        goal = np.zeros((len(chosen), system.shape[1], 1))
        goal[:, -1] = 1.0
        triangle = np.linalg.qr(np.concatenate([system, goal], 2), mode="r")
        for row, (square, there) in enumerate(zip(triangle, chosen >= 0, strict=True)):
            weights[start + row, there] = _fit_simplex_weights(
                square[:, :-1][:, there], square[:, -1], influences
            )
        missed = np.einsum("vfk,vk->vf", offsets, weights[part]).reshape(len(chosen), -1, 3)
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


def _fit_simplex_weights(system: np.ndarray, goal: np.ndarray, influences: int) -> np.ndarray:
    weights = np.zeros(system.shape[1])
    used = np.arange(system.shape[1])
    while True:
        part = nnls(system[:, used], goal)[0]
        used, part = used[part > 0], part[part > 0]
        if len(used) <= influences:
            break
        used = np.delete(used, part.argmin())
    weights[used] = part / part.sum()
    return weights
