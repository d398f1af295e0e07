"""Linear blend fits of vertices with fixed rest positions."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from ...body.body import Body
from ...fit.solvers.simplex_least_squares import simplex_least_squares
from ...geometry.laplacian import vertex_adjacency
from ..skeleton.reparent import BoneMotions

#: problems per batch, and the multiple to which columns are padded; few shapes are compiled
BATCH, WIDTH = 2048, 8


def neighbouring_bones(body: Body) -> list[list[int]]:
    """List for each bone the bones up to two joints away in the tree, and those adjacent on the surface."""
    parents, labels = np.array(body.skeleton.parents), np.asarray(body.skin.dominant_bones())
    near = np.eye(len(parents), dtype=bool)
    below = np.flatnonzero(parents >= 0)
    near[below, parents[below]] = near[parents[below], below] = True
    near = near @ near
    first, second = vertex_adjacency(np.asarray(body.faces), len(labels)).tocoo().coords
    near[labels[first], labels[second]] = True
    np.fill_diagonal(near, False)
    return [np.flatnonzero(row).tolist() for row in near]


def blend_grams(
    bones: BoneMotions,
    columns: list[int],
    rest: Float[np.ndarray, "C 3"],
    targets: Float[np.ndarray, "F C 3"],
    width: int,
) -> Float[np.ndarray, "C K K"]:
    """Compute Gram matrices, over bones, of the distances of each vertex from its goals; columns are padded
    to `width`."""
    frames, count = len(targets), len(columns)
    flat = bones.rotations[:, columns].transpose(3, 1, 0, 2).reshape(3, -1)
    images = (rest @ flat).reshape(len(rest), count, frames, 3)
    differences = images + (bones.translations[:, columns].swapaxes(0, 1) - targets.swapaxes(0, 1)[:, None])
    differences = differences.reshape(len(rest), count, 3 * frames)
    room = width - count
    return np.pad(differences @ differences.swapaxes(1, 2), ((0, 0), (0, room), (0, room)))


def fit_blends(
    grams: Float[np.ndarray, "C K K"], mask: Bool[np.ndarray, "C K"]
) -> tuple[Float[np.ndarray, "C"], Float[np.ndarray, "C K"]]:
    """Solve least squares over the simplex for the real columns; returns the residuals and the weights."""
    count, columns = mask.shape
    room = -columns % WIDTH
    wide = np.pad(grams, ((0, 0), (0, room), (0, room)))
    mask = np.pad(mask, ((0, 0), (0, room)))
    parts = [
        _fit(wide[first : first + BATCH], mask[first : first + BATCH]) for first in range(0, count, BATCH)
    ]
    weights = np.concatenate(parts)[:, :columns]
    return np.einsum("ck,ckl,cl->c", weights, grams, weights), weights


def _fit(grams: Float[np.ndarray, "C K K"], real: Bool[np.ndarray, "C K"]) -> Float[np.ndarray, "C K"]:
    """Solve for the weights of at most `BATCH` problems."""
    single_costs = np.where(real, np.einsum("ckk->ck", grams), np.inf)
    start = np.eye(grams.shape[1])[np.argmin(single_costs, 1)]
    size = np.maximum(single_costs.min(1), 1e-12)[:, None, None]
    room = BATCH - len(grams)
    filled = [
        np.concatenate([array, np.broadcast_to(array[:1], (room, *array.shape[1:]))])
        for array in (grams / size, start, real)
    ]
    scaled, begin, free = (jnp.asarray(array) for array in filled)
    weights = simplex_least_squares(scaled, jnp.zeros(begin.shape), begin, free)
    return np.asarray(weights, float)[: len(grams)]
