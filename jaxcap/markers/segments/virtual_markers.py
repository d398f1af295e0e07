"""Joints as virtual markers, which give a segment of two markers its frame."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from ..rotation_centres.joint import Joint
from .segment_frames import SegmentFrames, fit_segment_frames, two_marker_frames
from .segment_sets import Segments

#: weight of a joint against a marker when a frame is fitted
VIRTUAL_MARKER_WEIGHT = 0.5


class AugmentedMarkers(NamedTuple):
    """Markers, followed by virtual markers at joints for segments with too few markers."""

    positions: Float[np.ndarray, "F N 3"]
    seen: Bool[np.ndarray, "F N"]
    segments: Segments
    frames: SegmentFrames


def add_virtual_markers(
    positions: Float[np.ndarray, "F M 3"],
    seen: Bool[np.ndarray, "F M"],
    segments: Segments,
    frames: SegmentFrames,
    links: list[tuple[int, Joint]],
) -> AugmentedMarkers:
    """Add the centres of joints as virtual markers to the segments that need them.

    **Arguments:** `links` are pairs of a segment and a joint. The frame of the joint's parent is known and
    carries the centre.
    """
    columns, shown = [positions], [seen]
    members = [list(some) for some in segments.members]
    count = positions.shape[1]
    for segment, joint in links:
        r, o = frames.rotations[:, joint.parent], frames.origins[:, joint.parent]
        columns.append((r @ joint.in_parent + o)[:, None])
        shown.append(frames.known[:, joint.parent, None])
        members[segment].append(count)
        count += 1
    weights = np.concatenate([segments.weights, np.full(len(links), VIRTUAL_MARKER_WEIGHT)])
    wide = Segments(tuple(map(tuple, members)), weights, segments.names)
    all_places, all_seen = np.concatenate(columns, 1), np.concatenate(shown, 1)
    needed = {segment for segment, _ in links}
    only = Segments(
        tuple(some if k in needed else () for k, some in enumerate(wide.members)), weights, wide.names
    )
    fitted = fit_segment_frames(all_places, all_seen, only)
    template = np.concatenate([frames.local_positions, np.zeros((len(links), 3))])
    new = frames._replace(
        rotations=frames.rotations.copy(),
        origins=frames.origins.copy(),
        known=frames.known.copy(),
        local_positions=template,
    )
    for k in needed:
        new.rotations[:, k], new.origins[:, k] = fitted.rotations[:, k], fitted.origins[:, k]
        new.known[:, k] = fitted.known[:, k]
        new.local_positions[list(wide.members[k])] = fitted.local_positions[list(wide.members[k])]
    return AugmentedMarkers(all_places, all_seen, wide, new)


def assume_hinge(augmented: AugmentedMarkers, segment: int, base: int) -> AugmentedMarkers:
    """Compute frames of a segment of two markers, assuming as in the paper a hinge between it and `base`.

    The plane of its markers contains the nearest marker of the base segment.
    """
    first, second = augmented.segments.members[segment][:2]
    usual = [
        np.median(np.linalg.norm(augmented.positions[:, m] - augmented.positions[:, first], axis=1))
        + np.median(np.linalg.norm(augmented.positions[:, m] - augmented.positions[:, second], axis=1))
        for m in augmented.segments.members[base]
    ]
    marker = augmented.segments.members[base][int(np.argmin(usual))]
    shown = augmented.seen[:, first] & augmented.seen[:, second] & augmented.seen[:, marker]
    r, o, known = two_marker_frames(
        augmented.positions[:, first], augmented.positions[:, second], augmented.positions[:, marker], shown
    )
    frames = augmented.frames._replace(
        rotations=augmented.frames.rotations.copy(),
        origins=augmented.frames.origins.copy(),
        known=augmented.frames.known.copy(),
        local_positions=augmented.frames.local_positions.copy(),
    )
    frames.rotations[:, segment], frames.origins[:, segment], frames.known[:, segment] = r, o, known
    for m in (first, second):
        local = np.einsum("fba,fb->fa", r[known], augmented.positions[known, m] - o[known])
        frames.local_positions[m] = np.median(local, axis=0) if known.any() else 0.0
    return augmented._replace(frames=frames)
