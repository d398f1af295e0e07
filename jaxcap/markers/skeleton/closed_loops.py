"""Segments that stand still and would close a loop of bones: the feet of a person who squats are no bone."""

from itertools import count, islice

import numpy as np
from jaxtyping import Bool, Float

from ..segments.pair_distances import TRIMMED_FRACTION, motion_weights, weighted_quantiles
from ..segments.segment_sets import Segments, make_segments
from .segment_tree import SegmentTree, find_segment_tree, median_distance

#: largest cost of a joint of a segment that stands still, and of those that connect its neighbours without it, as a share of the
#: markers' median distance
MAX_COST = 0.08
#: fewest markers of each part
MIN_MARKERS = 2


def still_segments(
    positions: Float[np.ndarray, "F M 3"],
    seen: Bool[np.ndarray, "F M"],
    segments: Segments,
    unit: float,
) -> list[int]:
    """List the segments whose markers all stay in their places in the world, within the usual deviation."""
    weights = np.where(seen, motion_weights(positions, seen), 0.0)
    low, high = (
        np.stack(one, 1)
        for one in zip(
            *(
                weighted_quantiles(positions[..., axis], weights, (TRIMMED_FRACTION, 1 - TRIMMED_FRACTION))
                for axis in range(3)
            ),
            strict=True,
        )
    )
    still = np.linalg.norm(high - low, axis=1) < unit
    return [k for k, some in enumerate(segments.members) if still[list(some)].all()]


def open_loops(
    positions: Float[np.ndarray, "F M 3"],
    seen: Bool[np.ndarray, "F M"],
    segments: Segments,
    unit: float,
) -> Segments:
    """Split each segment that stands still and whose neighbours are connected without it.

    The floor holds feet in their places, so that all their distances are constant. With one bone for both feet, the legs are a
    loop, and a body is a tree. Each marker goes to the neighbour whose joint is nearest. A trunk that stands still closes no
    loop: without it, the limbs are not connected.
    """
    still = still_segments(positions, seen, segments, unit)
    most = MAX_COST * median_distance(positions, seen)
    # the last ones first: splitting a segment moves those after it
    for segment in reversed(still):
        others = [k for k in range(segments.num_segments) if k != segment]
        if len(others) < 2 or len(segments.members[segment]) < 2 * MIN_MARKERS:
            continue
        star = find_segment_tree(positions, seen, segments, pairs=[(segment, k) for k in others])
        centres = _centres_in(star, segment, most)
        if len(centres) < 2:
            continue
        rest = find_segment_tree(positions, seen, _select(segments, others))
        loop = _largest_connected(rest, [others.index(k) for k in centres], most)
        if len(loop) > 1:
            near = np.array([centres[others[k]] for k in loop])
            segments = _split(segments, segment, star.augmented.frames.local_positions, near)
    return segments


def _centres_in(star: SegmentTree, segment: int, most: float) -> dict[int, np.ndarray]:
    """Find the centres of the good joints with a segment in its frame, by the other segments."""
    joints = [
        joint
        for joint, cost in zip(star.joints, star.costs, strict=True)
        if joint is not None and cost < most and segment in (joint.parent, joint.child)
    ]
    return {
        joint.child if joint.parent == segment else joint.parent: joint.in_parent
        if joint.parent == segment
        else joint.in_child
        for joint in joints
    }


def _largest_connected(tree: SegmentTree, chosen: list[int], most: float) -> list[int]:
    """Find the largest group of segments that joints below a cost connect."""

    def top(segment: int) -> int:
        while tree.parents[segment] >= 0 and tree.costs[segment] < most:
            segment = tree.parents[segment]
        return segment

    tops = [top(segment) for segment in chosen]
    largest = max(tops, key=tops.count)
    return [segment for segment, one in zip(chosen, tops, strict=True) if one == largest]


def _split(
    segments: Segments,
    segment: int,
    local_positions: Float[np.ndarray, "N 3"],
    centres: Float[np.ndarray, "C 3"],
) -> Segments:
    """Split a segment: each marker goes to the nearest centre."""
    members = np.array(segments.members[segment])
    nearest = np.linalg.norm(local_positions[members][:, None] - centres, axis=-1).argmin(1)
    parts = [tuple(members[nearest == k].tolist()) for k in np.unique(nearest)]
    names = [name for k, name in enumerate(segments.names) if k != segment]
    free = (name for number in count() if (name := f"segment{number}") not in names)
    return make_segments(
        [*(some for k, some in enumerate(segments.members) if k != segment), *parts],
        len(segments.weights),
        segments.weights,
        (*names, *islice(free, len(parts))),
    )


def _select(segments: Segments, chosen: list[int]) -> Segments:
    members = tuple(segments.members[k] for k in chosen)
    inside = np.isin(np.arange(len(segments.weights)), [m for some in members for m in some])
    return Segments(
        members, np.where(inside, segments.weights, 0.0), tuple(segments.names[k] for k in chosen)
    )
