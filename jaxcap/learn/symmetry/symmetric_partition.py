"""Partitions of a symmetric surface that are their own mirror images."""

import numpy as np
from jaxtyping import Int

from .surface_symmetry import SurfaceSymmetry

#: a part is on the middle if at least this share of its vertices off the middle is on either side
BOTH_SIDES = 0.2


def mirror_partition(
    labels: Int[np.ndarray, "V"], symmetry: SurfaceSymmetry, side: int
) -> Int[np.ndarray, "V"]:
    """Replace the parts of one side of a partition by the mirrored ones of the other, `side`.

    Parts on the middle remain one part. Vertices of other parts that reach across the middle get the label -1.

    **Returns:** labels 0, 1, ... of the parts that are left; -1 for vertices without one.
    """
    sides, count = symmetry.sides, int(labels.max()) + 1
    ahead, behind = (np.bincount(labels[sides == sign], minlength=count) for sign in (side, -side))
    total = np.maximum(ahead + behind, 1)
    on_middle = (np.minimum(ahead, behind) >= BOTH_SIDES * total) | (ahead + behind == 0)
    own = on_middle | (ahead > behind)
    source = np.where(sides == -side, symmetry.mirrored, np.arange(len(labels)))
    found = np.where(own[labels[source]], labels[source], -1)
    copied = (sides == -side) & (found >= 0) & ~on_middle[labels[source]]
    found = np.where(copied, found + count, found)
    kept, numbers = np.unique(found[found >= 0], return_inverse=True)
    numbered = np.full(len(labels), -1)
    numbered[found >= 0] = numbers
    return numbered if len(kept) else np.zeros_like(labels)
