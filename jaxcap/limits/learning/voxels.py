"""Voxels of samples: small at the border of the observed range, large within it."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

#: number of times that voxels are merged, two by two along each axis
LEVELS = 2


class Voxels(NamedTuple):
    """Cubes with samples; intervals in charts of hinges, squares in those of universal joints."""

    centres: Float[np.ndarray, "N 3"]
    widths: Float[np.ndarray, "N"]
    #: number of samples in each
    counts: Float[np.ndarray, "N"]


def voxelise(
    coordinates: Float[np.ndarray, "F 3"],
    dimension: int,
    width: float,
    min_samples: int = 1,
    levels: int = LEVELS,
) -> Voxels:
    """Compute the voxels of `width` with at least `min_samples` samples, and merge them into larger ones.

    `min_samples` is the threshold of density. The merging replaces the paper's subdivision (Limits, section 4.1),
    from the bottom up.

    The paper keeps a cube whole where its density is above the threshold, for any distribution of samples in
    it. The primitive of this cube then extends over empty space. Here a cube is whole only where all voxels
    within it, and one layer around, are kept.

    **Raises:** `ValueError` where no cube has so many samples.
    """
    cells, counts = np.unique(
        np.floor(coordinates[:, :dimension] / width).astype(int), axis=0, return_counts=True
    )
    kept = counts >= min_samples
    if not kept.any():
        raise ValueError(
            f"No voxel has {min_samples:g} samples: of {len(coordinates)} samples, at most {counts.max()} are in one voxel of "
            f"{np.degrees(2 * width):.3g} degrees; reduce the threshold, widen the voxels, or give more motion."
        )
    sizes = np.ones(int(kept.sum()), int)
    cells, counts = cells[kept], counts[kept].astype(float)
    for level in range(1, levels + 1):
        cells, sizes, counts = _merge_voxels(cells, sizes, counts, 2**level)
    centres = np.zeros((len(cells), 3))
    centres[:, :dimension] = (cells + sizes[:, None] / 2) * width
    return Voxels(centres, sizes * width, counts)


def _merge_voxels(cells, sizes, counts, size: int):
    """Merge cubes of half of `size` where they fill a cube of `size` inside a kept layer."""
    dimension, half = cells.shape[1], size // 2
    corner = np.stack(np.meshgrid(*[[0, half]] * dimension, indexing="ij"), -1).reshape(-1, dimension)
    around = np.stack(np.meshgrid(*[[-half, 0, half, size]] * dimension, indexing="ij"), -1)
    occupied = {tuple(cell) for cell, s in zip(cells, sizes, strict=True) if s == half}
    index = {tuple(cell): i for i, cell in enumerate(cells)}
    gone = np.zeros(len(cells), bool)
    grown, sums = [], []
    for parent in {tuple(np.array(cell) // size * size) for cell in occupied}:
        block = around.reshape(-1, dimension) + np.array(parent)
        if all(tuple(cell) in occupied for cell in block):
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
