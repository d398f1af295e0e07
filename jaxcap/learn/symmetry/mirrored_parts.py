"""Parts of a symmetric surface that mirror each other, the joints between them, and the middle where other joints lie."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

#: least overlap of a part with the mirrored other one, intersection over union of their areas
MIN_OVERLAP = 0.4


class MirroredParts(NamedTuple):
    """For each part the one that mirrors it: itself on the middle, and -1 if there is none."""

    partners: Int[np.ndarray, "J"]

    @property
    def pairs(self) -> Int[np.ndarray, "P 2"]:
        """Pairs of different parts, the lesser first."""
        first = np.flatnonzero(self.partners > np.arange(len(self.partners)))
        return np.stack([first, self.partners[first]], 1)


def mirror_parts(
    labels: Int[np.ndarray, "V"], areas: Float[np.ndarray, "V"], mirrored: Int[np.ndarray, "V"], count: int
) -> MirroredParts:
    """Match every part with the one that its mirror image overlaps most, if each is the best match of the other.

    **Arguments:** the part of each vertex; areas of the vertices; `mirrored`, the vertex on the other side of each; the number
    of parts.
    """
    there = labels[mirrored]
    shared = np.zeros((count, count))
    np.add.at(shared, (labels, there), areas)
    shared = (shared + shared.T) / 2
    sizes = shared.sum(1)
    overlaps = shared / np.maximum(sizes[:, None] + sizes - shared, 1e-300)
    best = np.argmax(overlaps, 1)
    rows = np.arange(count)
    mutual = (best[best] == rows) & (overlaps[rows, best] > MIN_OVERLAP)
    return MirroredParts(np.where(mutual, best, -1))


def mirror_joints(parts: MirroredParts, parents: Sequence[int]) -> MirroredParts:
    """Match joints. Joint j connects part j with the part of its parent, and both parts must be mirrored."""
    above = np.array(parents)
    partners = np.append(parts.partners, -1)
    own = partners[:-1]
    # the parent of the partner is the partner of the parent; a root has no parent
    alike = (above < 0) | (partners[above] == above[own])
    return MirroredParts(np.where((own >= 0) & alike & ((above < 0) == (above[own] < 0)), own, -1))


def middle_joints(joints: MirroredParts, parents: Sequence[int]) -> Bool[np.ndarray, "J"]:
    """Test which joints are on the middle: those between two parts that are their own mirrors."""
    rows, above = np.arange(len(parents)), np.array(parents)
    own = joints.partners == rows
    return own & (above >= 0) & own[above]
