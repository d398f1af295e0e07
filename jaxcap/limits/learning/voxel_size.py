"""Choice of voxel sizes by cross-validation: the finest that still predict the rest of a capture."""

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import KDTree

from ...errors import InputError
from ...geometry.sampling import even_indices
from .held_out import Fold, block_folds

#: degrees of rotation, tried from the finest
WIDTHS = (1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0, 12.0, 15.0, 20.0, 25.0, 30.0)
#: widths of a child's voxels and of its parent's keyframes, degrees, tried together
CHILD_WIDTHS = (2.0, 4.0, 8.0, 12.0, 20.0)
KEYFRAMES = (10.0, 15.0, 20.0, 30.0, 40.0, 60.0)
#: largest number of frames that keyframes are chosen on
MAX_FRAMES = 10000


def choose_voxel_width(
    coordinates: Float[np.ndarray, "F 3"],
    dimension: int,
    blocks: Int[np.ndarray, "F"],
    min_samples: int,
    coverage: float,
) -> float:
    """Choose the finest voxel width that reaches a share `coverage` in cross-validation over blocks.

    The share is that of held-out samples near samples of the other blocks. The width is in the chart, half
    of that in rotation. The widest is returned where none reaches the share.
    """
    for degrees in WIDTHS:
        width = np.radians(degrees) / 2
        shares = [
            _is_near(
                coordinates[test],
                occupied_voxels(coordinates[train], dimension, width, min_samples),
                dimension,
                width,
            ).mean()
            for train, test in block_folds(blocks)
        ]
        if np.mean(shares) >= coverage:
            return width
    return np.radians(WIDTHS[-1]) / 2


def choose_keyframes(
    coordinates: Float[np.ndarray, "F 3"],
    parent_coordinates: Float[np.ndarray, "F 3"],
    dimensions: tuple[int, int],
    blocks: Int[np.ndarray, "F"],
    min_samples: int,
    coverage: float,
    voxel: float | None = None,
    keyframe: float | None = None,
) -> tuple[float, float]:
    """Choose the widths of a child's voxels and of its parent's keyframes, of which one may be given.

    Among the pairs that allow the share `coverage` of held-out frames, it is the one that allows the fewest
    combinations of children and parents of different frames, which is the tightest. The loosest is returned
    where none reaches the share.
    """
    some = even_indices(len(coordinates), MAX_FRAMES)
    coordinates, parent_coordinates, blocks = coordinates[some], parent_coordinates[some], blocks[some]
    widths = np.radians(CHILD_WIDTHS) / 2 if voxel is None else np.array([voxel])
    key_widths = np.radians(KEYFRAMES) / 2 if keyframe is None else np.array([keyframe])
    best, least = (float(widths[-1]), float(key_widths[-1])), np.inf
    for key_width in key_widths:
        tries = [
            _coupled_coverage(
                coordinates, parent_coordinates, fold, dimensions, widths, key_width, min_samples
            )
            for fold in block_folds(blocks)
        ]
        seen, shuffled = (np.mean([one[i] for one in tries], axis=0) for i in range(2))
        for number, width in enumerate(widths):
            if seen[number] >= coverage and shuffled[number] < least:
                best, least = (float(width), float(key_width)), shuffled[number]
    return best


def _coupled_coverage(
    coordinates,
    parent_coordinates,
    fold: Fold,
    dimensions: tuple[int, int],
    widths: Float[np.ndarray, "W"],
    key_width: float,
    min_samples: int,
) -> Float[np.ndarray, "2 W"]:
    """Compute the shares of test frames that are allowed, for each width of the child's voxels.

    The second row is for the same children with the parents of other frames. A child is allowed near
    training samples with parents within a width of the keyframe's centre.
    """
    train, test = fold
    keys = occupied_voxels(parent_coordinates[train], dimensions[1], key_width, 1)
    nearest = np.asarray(KDTree(keys).query(parent_coordinates[test])[1])
    shuffled = np.random.default_rng(0).permutation(len(test))
    around = {
        key: np.abs(parent_coordinates[train] - keys[key]).max(1) <= key_width for key in np.unique(nearest)
    }
    shares = np.zeros((2, len(widths)))
    for number, width in enumerate(widths):
        try:
            centres, home = assign_voxels(coordinates[train], dimensions[0], width, min_samples)
        except InputError:
            # nothing is allowed
            continue
        for key, seen in around.items():
            here, cells = nearest == key, centres[np.unique(home[seen])]
            for row, children in enumerate((coordinates[test], coordinates[test][shuffled])):
                shares[row, number] += _is_near(children[here], cells, dimensions[0], width).sum()
    return shares / len(test)


def occupied_voxels(coordinates, dimension: int, width: float, min_samples: int) -> np.ndarray:
    """Compute the centres of voxels with at least `min_samples` samples."""
    cells, counts = np.unique(np.floor(coordinates[:, :dimension] / width), axis=0, return_counts=True)
    centres = np.zeros((int((counts >= min_samples).sum()), 3))
    centres[:, :dimension] = (cells[counts >= min_samples] + 0.5) * width
    return centres


def assign_voxels(
    coordinates: Float[np.ndarray, "F 3"], dimension: int, width: float, min_samples: int
) -> tuple[Float[np.ndarray, "N 3"], Int[np.ndarray, "F"]]:
    """Compute the centres of voxels with at least `min_samples` samples, and the nearest of these voxels to each sample.

    **Raises:** `InputError` where no voxel has so many samples.
    """
    cells, home, counts = np.unique(
        np.floor(coordinates[:, :dimension] / width), axis=0, return_inverse=True, return_counts=True
    )
    kept = counts >= min_samples
    if not kept.any():
        raise InputError(
            f"No voxel has {min_samples:g} samples when a part of the motion is left out: of {len(coordinates)} samples, at most "
            f"{counts.max()} are in one voxel of {np.degrees(2 * width):.3g} degrees; reduce the threshold, or give more motion."
        )
    centres = np.zeros((int(kept.sum()), 3))
    centres[:, :dimension] = (cells[kept] + 0.5) * width
    if kept.all():
        return centres, home.reshape(-1)
    return centres, np.asarray(KDTree(centres).query(coordinates)[1])


def _is_near(coordinates, centres, dimension: int, width: float) -> np.ndarray:
    """Test if positions are in a ball around a voxel."""
    if not len(centres) or not len(coordinates):
        return np.zeros(len(coordinates), bool)
    return KDTree(centres).query(coordinates)[0] <= np.sqrt(dimension) * width / 2
