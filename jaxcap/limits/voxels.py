"""Where samples lie, as cubes: small at the border of what was seen, large within it."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

#: how often cubes are joined, two by two along each axis
LEVELS = 2


class Voxels(NamedTuple):
    """Cubes that hold samples; in hinges' charts stretches, in universal joints' squares."""

    centres: Float[np.ndarray, "N 3"]
    widths: Float[np.ndarray, "N"]
    #: samples in each
    counts: Float[np.ndarray, "N"]


def voxelise(
    places: Float[np.ndarray, "F 3"], dimension: int, width: float, least: int = 1, levels: int = LEVELS
) -> Voxels:
    """The cubes of `width` with at least `least` samples, which is the threshold of density, joined
    into larger ones (Limits, section 4.1, from below: what splits no further there joins here).

    The paper keeps a cube whole where its density is above the threshold, however its samples lie in
    it, and the primitive that fills it then bulges over what is empty. Here a cube is whole only where
    all within it, and one layer around, are kept.

    **Raises:** `ValueError` where no cube has so many samples.
    """
    cells, counts = np.unique(np.floor(places[:, :dimension] / width).astype(int), axis=0, return_counts=True)
    kept = counts >= least
    if not kept.any():
        raise ValueError(
            f"No voxel has {least:g} samples: the {len(places)} samples are at most {counts.max()} in one voxel of "
            f"{np.degrees(2 * width):.3g} degrees; lower the threshold, widen voxels, or give more motion."
        )
    sizes = np.ones(int(kept.sum()), int)
    cells, counts = cells[kept], counts[kept].astype(float)
    for level in range(1, levels + 1):
        cells, sizes, counts = _join(cells, sizes, counts, 2**level)
    centres = np.zeros((len(cells), 3))
    centres[:, :dimension] = (cells + sizes[:, None] / 2) * width
    return Voxels(centres, sizes * width, counts)


def _join(cells, sizes, counts, size: int):
    """Cubes of half of `size` that fill one of `size` within a kept layer become it."""
    dimension, half = cells.shape[1], size // 2
    corner = np.stack(np.meshgrid(*[[0, half]] * dimension, indexing="ij"), -1).reshape(-1, dimension)
    around = np.stack(np.meshgrid(*[[-half, 0, half, size]] * dimension, indexing="ij"), -1)
    there = {tuple(cell) for cell, s in zip(cells, sizes, strict=True) if s == half}
    index = {tuple(cell): i for i, cell in enumerate(cells)}
    gone = np.zeros(len(cells), bool)
    grown, sums = [], []
    for parent in {tuple(np.array(cell) // size * size) for cell in there}:
        block = around.reshape(-1, dimension) + np.array(parent)
        if all(tuple(cell) in there for cell in block):
            members = [index[tuple(cell)] for cell in corner + np.array(parent)]
            gone[members] = True
            grown.append(parent)
            sums.append(counts[members].sum())
    if not grown:
        return cells, sizes, counts
    return (
        np.concatenate([cells[~gone], np.array(grown)]),
        np.concatenate([sizes[~gone], np.full(len(grown), size)]),
        np.concatenate([counts[~gone], sums]),
    )
