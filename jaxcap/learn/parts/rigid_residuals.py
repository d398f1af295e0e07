"""Moving surfaces, and the residuals of rigid motions of sets of their vertices."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from ...geometry.procrustes import Moments, group_moments
from .surface_graph import SurfaceGraph, membership


class MovingSurface(NamedTuple):
    """A moving surface with each frame centred at its mean, against cancellation."""

    surface: SurfaceGraph
    rest: Float[np.ndarray, "V 3"]
    #: the path of each vertex over the frames
    paths: Float[np.ndarray, "V F 3"]


def part_moments(scene: MovingSurface, labels: Int[np.ndarray, "V"], count: int) -> Moments:
    """Compute the moments of `count` parts, vertices weighted by area; vertices with negative labels are
    ignored."""
    labelled = np.flatnonzero(labels >= 0)
    groups = membership(labels[labelled], scene.surface.areas[labelled], count)
    return group_moments(groups, scene.rest[labelled], scene.paths[labelled])


def part_costs(
    scene: MovingSurface, rotations: Float[np.ndarray, "K F 3 3"], translations: Float[np.ndarray, "K F 3"]
) -> Float[np.ndarray, "V K"]:
    """Compute the squared residuals, summed over frames, of each vertex under the motion of each part.

    The rest position of the vertex is optimal for each part.
    """
    frames = scene.paths.shape[1]
    flat = scene.paths.reshape(len(scene.paths), -1)
    sums = _sum_inverse_motions(flat, rotations, translations)
    squares = np.einsum("vi,vi->v", flat, flat)[:, None] + np.sum(translations**2, (1, 2))
    squares = squares - 2 * flat @ translations.reshape(len(translations), -1).T
    return np.maximum(squares - np.sum(sums * sums, -1) / frames, 0.0)


def mean_rest_positions(
    scene: MovingSurface, labels: np.ndarray, rotations: np.ndarray, translations: np.ndarray
) -> Float[np.ndarray, "V 3"]:
    """Compute the mean over frames of each vertex moved back to rest by its part."""
    frames = scene.paths.shape[1]
    back = np.zeros_like(scene.rest)
    for part in range(len(rotations)):
        members = labels == part
        flat = scene.paths[members].reshape(-1, 3 * frames)
        back[members] = (
            _sum_inverse_motions(flat, rotations[part : part + 1], translations[part : part + 1])[:, 0]
            / frames
        )
    return back


def _sum_inverse_motions(flat: np.ndarray, rotations: np.ndarray, translations: np.ndarray) -> np.ndarray:
    """Sum `R^T (x - t)` over frames, (V, K, 3)."""
    count = len(rotations)
    columns = rotations.reshape(count, -1, 3).transpose(1, 0, 2).reshape(-1, 3 * count)
    shift = np.einsum("kfab,kfa->kb", rotations, translations)
    return (flat @ columns).reshape(-1, count, 3) - shift
