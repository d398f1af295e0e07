"""A skinned surface in the files of skinned bodies."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from ...errors import InputError
from ...geometry.mesh import triangle_sides


class SkinnedSurface(NamedTuple):
    """Vertices in the bind pose with skinning weights, which sum to one."""

    vertices: Float[np.ndarray, "V 3"]
    faces: Int[np.ndarray, "F 3"]
    weights: Float[np.ndarray, "V J"]
    #: displacements of the vertices by K shape keys; None if they are not read
    displacements: Float[np.ndarray, "V K 3"] | None = None


def normalise_weights(weights: Float[np.ndarray, "V J"], where: str) -> Float[np.ndarray, "V J"]:
    """Normalise weights to a sum of one.

    Raises `InputError` for a vertex without any; `where` names its mesh.
    """
    total = weights.sum(1)
    if not (total > 0).all():
        raise InputError(
            f"{where}: vertex {int(np.argmin(total > 0))} has no weights; bind the whole mesh to the skeleton."
        )
    return weights / total[:, None]


def concatenate_surfaces(parts: Sequence[SkinnedSurface]) -> SkinnedSurface:
    """Concatenate several surfaces."""
    starts = np.cumsum([0, *(len(part.vertices) for part in parts[:-1])])
    moved = [part.displacements for part in parts if part.displacements is not None]
    return SkinnedSurface(
        np.concatenate([part.vertices for part in parts]),
        np.concatenate([part.faces + start for part, start in zip(parts, starts, strict=True)]),
        np.concatenate([part.weights for part in parts]),
        np.concatenate(moved) if moved else None,
    )


def merge_seams(surface: SkinnedSurface) -> SkinnedSurface:
    """Merge vertices on open edges that have the same position, weights and displacements.

    Programs split these along seams, as each side has its own texture coordinates or normal.
    """
    faces, count = surface.faces, len(surface.vertices)
    edges = np.sort(triangle_sides(faces), axis=1)
    named, times = np.unique(edges, axis=0, return_counts=True)
    itself = np.arange(1, count + 1)
    itself[named[times == 1]] = 0
    keys = [] if surface.displacements is None else [surface.displacements.reshape(count, -1)]
    rows = np.concatenate([surface.vertices, surface.weights, *keys, itself[:, None]], axis=1).astype("<f4")
    _, first, where = np.unique(rows, axis=0, return_index=True, return_inverse=True)
    # in the original order
    order = np.argsort(first)
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order))
    kept, faces = first[order], rank[where.reshape(-1)][faces]
    flat = (faces[:, 0] == faces[:, 1]) | (faces[:, 1] == faces[:, 2]) | (faces[:, 2] == faces[:, 0])
    moved = None if surface.displacements is None else surface.displacements[kept]
    return SkinnedSurface(surface.vertices[kept], faces[~flat], surface.weights[kept], moved)
