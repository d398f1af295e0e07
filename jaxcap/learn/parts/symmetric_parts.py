"""Rigid parts that are mirror images of each other, on a surface with a left-right symmetry."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Int

from ..symmetry.surface_symmetry import SurfaceSymmetry
from ..symmetry.symmetric_partition import mirror_partition
from .part_kmeans import PartState, improve_parts, settle_parts
from .rigid_residuals import MovingSurface

#: numbers of parts that are tried besides a given one
OTHER_NUMBERS = (-1, 1)


class SymmetricParts(NamedTuple):
    """Parts of a surface with a left-right symmetry, in pairs if the motion allows it."""

    state: PartState
    #: the least share by which parts in pairs have a larger root mean square error than parts of any shape; the price of each
    #: part is included
    cost: float


def improve_symmetric_parts(
    scene: MovingSurface,
    partition: Callable[[int], Int[np.ndarray, "V"]],
    num_parts: int,
    is_fixed: bool,
    symmetry: SurfaceSymmetry,
    min_gain: float,
    max_cost: float,
) -> SymmetricParts:
    """Refine parts, and replace those of one side by the mirrored parts of the other, if both sides move alike.

    The side with the lower error wins; one more part has to lower the root mean square error by `min_gain`. If parts in pairs
    cost more than a share `max_cost`, or if the number `is_fixed` and no symmetric partition has it, the parts are returned as they were found.

    **Arguments:** `partition` gives the labels of a number of parts to begin with.
    """
    numbers = [num_parts, *(num_parts + more for more in OTHER_NUMBERS if is_fixed and num_parts + more > 1)]
    found: list[PartState] = []
    plain = None
    for number in numbers:
        state = improve_parts(scene, partition(number), number)
        plain = state if plain is None else plain
        found += [
            mirrored
            for side in (1, -1)
            if (mirrored := _mirrored(scene, state, symmetry, side)) is not None
            and (not is_fixed or len(mirrored.motions.rotations) == num_parts)
        ]
        if is_fixed and found:
            break
    assert plain is not None
    if not found:
        return SymmetricParts(plain, 0.0)
    scores = [_score(scene, state, min_gain) for state in found]
    best = int(np.argmin(scores))
    cost = float(np.expm1(scores[best] - _score(scene, plain, min_gain)))
    return SymmetricParts(found[best] if cost <= max_cost else plain, cost)


def _mirrored(
    scene: MovingSurface, state: PartState, symmetry: SurfaceSymmetry, side: int
) -> PartState | None:
    """Mirror the parts of one side, and refine their borders; None if a part would be empty."""
    labels = mirror_partition(state.labels, symmetry, side)
    count = int(labels.max()) + 1
    settled = settle_parts(scene, labels, count)
    return settled if len(np.unique(settled.labels)) == count else None


def _score(scene: MovingSurface, state: PartState, min_gain: float) -> float:
    """Return the logarithm of the root mean square error, with the price of each part."""
    return 0.5 * float(np.log(max(state.error(scene), 1e-300))) + min_gain * len(state.motions.rotations)
