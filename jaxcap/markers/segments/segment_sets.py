"""Segments: sets of markers that move rigidly together."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from ...arguments import checked


class Segments(NamedTuple):
    """A partition of M markers into K segments. A marker of no segment is loose."""

    #: marker indices of each segment
    members: tuple[tuple[int, ...], ...]
    #: weight of each marker's attachment, above 0 to 1; zero where it is loose
    weights: Float[np.ndarray, "M"]
    names: tuple[str, ...]

    @property
    def num_segments(self) -> int:
        """The number of segments, K."""
        return len(self.members)

    @property
    def marker_segments(self) -> Int[np.ndarray, "M"]:
        """The segment of each marker, -1 where it is loose."""
        owner = np.full(len(self.weights), -1)
        for segment, members in enumerate(self.members):
            owner[list(members)] = segment
        return owner

    @property
    def is_loose(self) -> Bool[np.ndarray, "M"]:
        """Mask of markers that belong to no segment."""
        return self.marker_segments < 0


@checked
def make_segments(members, num_markers: int, weights=None, names=None) -> Segments:
    """Build `Segments` and check them.

    By default `weights (M,)` are one and `names` are `segment0`, `segment1`, ...

    **Raises:** `ValueError` with one sentence for an empty segment, a marker that does not exist or is in
    two segments, names that repeat, or a weight that is not in (0, 1].
    """
    members = tuple(tuple(int(m) for m in some) for some in members)
    names = tuple(f"segment{k}" for k in range(len(members))) if names is None else tuple(names)
    if len(names) != len(members) or len(set(names)) != len(names):
        raise ValueError(
            f"There are {len(members)} segments with the names {names}; give each segment its own name."
        )
    owner: dict[int, str] = {}
    for name, some in zip(names, members, strict=True):
        if not some:
            raise ValueError(f"The segment '{name}' has no markers; add markers or leave the segment out.")
        for marker in some:
            if not 0 <= marker < num_markers:
                raise ValueError(
                    f"The segment '{name}' has the marker {marker}; expected 0 to {num_markers - 1}."
                )
            if marker in owner:
                raise ValueError(
                    f"Marker {marker} is in '{owner[marker]}' and in '{name}'; a marker can be in one "
                    "segment only."
                )
            owner[marker] = name
    weights = np.ones(num_markers) if weights is None else np.array(weights, float)
    if weights.shape != (num_markers,):
        raise ValueError(
            f"There are {weights.size} weights for {num_markers} markers; give one weight for each marker."
        )
    inside = np.isin(np.arange(num_markers), list(owner))
    if not ((weights[inside] > 0) & (weights[inside] <= 1)).all():
        raise ValueError(
            "A weight of attachment is outside its range; expected above 0 and at most 1. Leave loose "
            "markers out."
        )
    return Segments(members, np.where(inside, weights, 0.0), names)
