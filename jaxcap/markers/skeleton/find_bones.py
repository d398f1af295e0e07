"""The bones of a recording: rigid segments, without closed loops, and with the lone markers that bones need."""

import numpy as np
from jaxtyping import Bool, Float

from ..segments.find_segments import find_partition
from ..segments.pair_distances import median_distances
from ..segments.segment_sets import Segments
from .closed_loops import open_loops
from .lone_markers import place_lone_markers
from .segment_tree import find_segment_tree


def find_bones(
    positions: Float[np.ndarray, "F M 3"], seen: Bool[np.ndarray, "F M"], threshold: float | None = None
) -> Segments:
    """Find the segments that bones are made of.

    Sets of markers that move rigidly (`find_partition`) are changed where a tree of bones shows that they are wrong: feet that the floor
    holds are two bones (`open_loops`), and a bone may have one marker (`place_lone_markers`). A given `threshold` is that of
    `find_partition`; markers that exceed it stay loose.
    """
    partition = find_partition(positions, seen, threshold)
    segments = open_loops(positions, seen, partition.segments, partition.unit)
    if threshold is not None or not (segments.is_loose & seen.any(0)).any():
        return segments
    tree = find_segment_tree(positions, seen, segments)
    return place_lone_markers(tree, segments, partition, median_distances(positions, seen))
