"""Markers that no segment contains: the only markers of a bone, or markers with large errors on one."""

import numpy as np
from jaxtyping import Float

from ..segments.borrowed_markers import MAX_RATIO, find_partner
from ..segments.find_segments import Partition, attachment_weights
from ..segments.segment_sets import Segments, make_segments
from .segment_tree import SegmentTree

#: cost of a joint, in units of the usual deviation of markers, above which a bone between the two segments may be missing
MISSING_BONE_RATIO = 1.5


def place_lone_markers(
    tree: SegmentTree,
    segments: Segments,
    partition: Partition,
    distances: Float[np.ndarray, "M M"],
) -> Segments:
    """Make bones of lone markers where one is missing, and attach others to the segments that they nearly move with.

    A marker that keeps its distance from one of a segment, which no joint connects well to the others, is the only marker of
    the bone between: the thigh of a gait model, whose marker at the knee is on the shank. Such markers that keep their distances from each
    other share a bone. Any other marker joins the segment from which its
    distances vary least, if by less than three times the usual deviation.

    **Arguments:** `tree` of the segments; `distances` the median distance of every pair of markers, metres.
    """
    deviations, unit = partition.deviations, partition.unit
    known = np.where(np.isnan(deviations), np.inf, deviations)
    owner, members = segments.marker_segments, [list(some) for some in segments.members]
    strained = _strained_segments(tree, MISSING_BONE_RATIO * unit)
    bones: list[list[int]] = []
    for marker in np.flatnonzero(owner < 0).tolist():
        partner = find_partner(marker, owner, deviations, distances, unit)
        if partner is not None and owner[partner] in strained:
            near = [bone for bone in bones if known[marker, bone].max() < MAX_RATIO * unit]
            if near:
                near[0].append(marker)
            else:
                bones.append([marker])
            continue
        usual = [float(np.sqrt(np.mean(known[marker, list(some)] ** 2))) for some in segments.members]
        best = int(np.argmin(usual))
        if usual[best] < MAX_RATIO * unit:
            members[best].append(marker)
    if not bones and members == [list(some) for some in segments.members]:
        return segments
    everyone = [*members, *bones]
    weights = np.where(segments.is_loose, attachment_weights(everyone, known, unit), segments.weights)
    names = (*segments.names, *_new_names(segments.names, len(bones)))
    return make_segments(everyone, len(owner), weights, names)


def _strained_segments(tree: SegmentTree, most: float) -> set[int]:
    """Find the segments at joints above a cost, and on the smaller side of these joints; those without a joint too."""
    count = len(tree.parents)
    strained = set(tree.roots) if len(tree.roots) > 1 else set()
    for child, parent in enumerate(tree.parents):
        if parent >= 0 and tree.costs[child] > most:
            below = {k for k in range(count) if child in _ancestors(tree, k)}
            smaller = below if 2 * len(below) <= count else set(range(count)) - below
            strained |= smaller | {child, parent}
    return strained


def _ancestors(tree: SegmentTree, segment: int) -> list[int]:
    """List a segment and all above it."""
    path = [segment]
    while tree.parents[path[-1]] >= 0:
        path.append(tree.parents[path[-1]])
    return path


def _new_names(taken: tuple[str, ...], count: int) -> list[str]:
    free = (name for number in range(len(taken) + count) if (name := f"segment{number}") not in taken)
    return [next(free) for _ in range(count)]
