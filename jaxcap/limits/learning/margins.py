"""Choice of margins by leaving whole takes or people out: how far others go beyond what was seen.

Voxels show where samples are. The margin around them is how far the samples of a take, or of a person, lie from those
of all others. A child is compared with the samples whose parents are near, so that a parent in a new region is compared
with the nearest region that was seen.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.spatial import KDTree

from ...geometry.sampling import even_indices
from .held_out import Fold, mean_quantile
from .voxel_size import assign_voxels, occupied_voxels

#: width of voxels by the number of angles, degrees of rotation
RESOLUTION = {1: 2.0, 2: 4.0, 3: 8.0}
#: widths of keyframes that are tried, degrees
KEYFRAMES = (10.0, 15.0, 20.0, 25.0, 30.0, 40.0, 60.0)
#: growth of the margin of a child by the distance of its parent from what was seen
GROWTH = 2.0
#: largest number of samples of a fold that are tested
MAX_TESTED = 4000


def choose_margin(
    coordinates: Float[np.ndarray, "F 3"],
    dimension: int,
    folds: list[Fold],
    width: float,
    min_samples: int,
    coverage: float,
) -> float:
    """Choose the smallest margin around voxels of the other folds that contains a share `coverage` of each fold, on
    average over the folds; in the chart, half of that in rotation.

    **Raises:** `InputError` where the other folds have no voxel with `min_samples` samples.
    """
    beyond = []
    for train, test in folds:
        test = test[even_indices(len(test), MAX_TESTED)]
        cells = assign_voxels(coordinates[train], dimension, width, min_samples)[0]
        beyond.append(_beyond(coordinates[test], cells, dimension, width))
    return mean_quantile(beyond, coverage)


class CoupledMargin(NamedTuple):
    """The margin of a child, the width of its parent's keyframes, both in the chart, and the growth of the margin."""

    margin: float
    keyframe: float
    #: by the distance of the parent from the balls around all keyframes
    growth: float


def choose_coupled_margin(
    coordinates: Float[np.ndarray, "F 3"],
    parent_coordinates: Float[np.ndarray, "F 3"],
    dimensions: tuple[int, int],
    folds: list[Fold],
    width: float,
    min_samples: int,
    coverage: float,
    key_width: float | None = None,
) -> CoupledMargin:
    """Choose the margin of a child and the width of the keyframes of its parent.

    For each width, the margin is as in `choose_margin`, among the samples around the keyframe nearest to the parent. It is
    larger by `GROWTH` times the distance of the parent from the rotations of the parent in the other folds: children of
    parents that were not seen say little about those of parents that were.
    Among the widths it is the one with which the fewest children are allowed with the parents of other frames.

    **Raises:** `InputError` where the other folds have no voxel with `min_samples` samples.
    """
    best, least = CoupledMargin(0.0, 0.0, GROWTH), np.inf
    widths = np.radians(KEYFRAMES) / 2 if key_width is None else [key_width]
    voxels = [assign_voxels(coordinates[train], dimensions[0], width, min_samples) for train, _ in folds]
    for each in widths:
        found = [
            _coupled_beyond(coordinates, parent_coordinates, fold, own, dimensions, width, float(each))
            for fold, own in zip(folds, voxels, strict=True)
        ]
        # a negative excess is within the growth of the margin
        margin = max(mean_quantile([seen for seen, _ in found], coverage), 0.0)
        shuffled = float(np.mean([(other <= margin).mean() for _, other in found]))
        if shuffled < least:
            best, least = CoupledMargin(margin, float(each), GROWTH), shuffled
    return best


def _coupled_beyond(
    coordinates,
    parent_coordinates,
    fold: Fold,
    voxels,
    dimensions: tuple[int, int],
    width: float,
    key_width: float,
):
    """Compute how far test children are from those of training samples with parents near theirs, and with parents of
    other frames, less the growth of the margin."""
    (train, test), (centres, home) = fold, voxels
    test = test[even_indices(len(test), MAX_TESTED)]
    keys = occupied_voxels(parent_coordinates[train], dimensions[1], key_width, 1)
    away, nearest = KDTree(keys).query(parent_coordinates[test])
    grown = GROWTH * np.maximum(away - np.sqrt(dimensions[1]) * key_width / 2, 0.0)
    children = coordinates[test], coordinates[test][np.random.default_rng(0).permutation(len(test))]
    beyond = np.zeros((2, len(test)))
    for key in np.unique(nearest):
        around = np.abs(parent_coordinates[train] - keys[key]).max(1) <= key_width
        cells, here = centres[np.unique(home[around])], nearest == key
        for row, each in enumerate(children):
            beyond[row, here] = _beyond(each[here], cells, dimensions[0], width) - grown[here]
    return beyond[0], beyond[1]


def _beyond(coordinates, cells, dimension: int, width: float) -> Float[np.ndarray, "_"]:
    """Compute the distances from the balls around voxels, zero within them."""
    distance = np.asarray(KDTree(cells).query(coordinates)[0])
    return np.maximum(distance - np.sqrt(dimension) * width / 2, 0.0)
