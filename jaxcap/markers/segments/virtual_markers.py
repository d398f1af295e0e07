"""Joints as virtual markers, which give a segment of two markers its frame."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from ..rotation_centres.joint import Joint
from .segment import Segments
from .segment_frames import SegmentFrames, fit_frames, pair_frames

#: weight of a joint against a marker when a frame is fitted
WEIGHT = 0.5


class Augmented(NamedTuple):
    """Markers, followed by virtual markers at joints for segments with too few markers."""

    places: Float[np.ndarray, "F N 3"]
    seen: Bool[np.ndarray, "F N"]
    segments: Segments
    frames: SegmentFrames


def augment(
    places: Float[np.ndarray, "F M 3"],
    seen: Bool[np.ndarray, "F M"],
    segments: Segments,
    frames: SegmentFrames,
    links: list[tuple[int, Joint]],
) -> Augmented:
    """Add the centres of joints as virtual markers to the segments that need them.

    **Arguments:** `links` are pairs of a segment and a joint. The frame of the joint's parent is known and
    carries the centre.
    """
    columns, shown = [places], [seen]
    members = [list(some) for some in segments.members]
    count = places.shape[1]
    for segment, joint in links:
        r, o = frames.rotations[:, joint.parent], frames.origins[:, joint.parent]
        columns.append((r @ joint.in_parent + o)[:, None])
        shown.append(frames.known[:, joint.parent, None])
        members[segment].append(count)
        count += 1
    weights = np.concatenate([segments.weights, np.full(len(links), WEIGHT)])
    wide = Segments(tuple(map(tuple, members)), weights, segments.names)
    all_places, all_seen = np.concatenate(columns, 1), np.concatenate(shown, 1)
    needed = {segment for segment, _ in links}
    only = Segments(
        tuple(some if k in needed else () for k, some in enumerate(wide.members)), weights, wide.names
    )
    fitted = fit_frames(all_places, all_seen, only)
    template = np.concatenate([frames.template, np.zeros((len(links), 3))])
    new = frames._replace(
        rotations=frames.rotations.copy(),
        origins=frames.origins.copy(),
        known=frames.known.copy(),
        template=template,
    )
    for k in needed:
        new.rotations[:, k], new.origins[:, k] = fitted.rotations[:, k], fitted.origins[:, k]
        new.known[:, k] = fitted.known[:, k]
        new.template[list(wide.members[k])] = fitted.template[list(wide.members[k])]
    return Augmented(all_places, all_seen, wide, new)


def hinge_assumed(now: Augmented, segment: int, base: int) -> Augmented:
    """Compute frames of a segment of two markers, assuming as in the paper a hinge between it and `base`.

    The plane of its markers contains the nearest marker of the base segment.
    """
    first, second = now.segments.members[segment][:2]
    usual = [
        np.median(np.linalg.norm(now.places[:, m] - now.places[:, first], axis=1))
        + np.median(np.linalg.norm(now.places[:, m] - now.places[:, second], axis=1))
        for m in now.segments.members[base]
    ]
    marker = now.segments.members[base][int(np.argmin(usual))]
    shown = now.seen[:, first] & now.seen[:, second] & now.seen[:, marker]
    r, o, known = pair_frames(now.places[:, first], now.places[:, second], now.places[:, marker], shown)
    frames = now.frames._replace(
        rotations=now.frames.rotations.copy(),
        origins=now.frames.origins.copy(),
        known=now.frames.known.copy(),
        template=now.frames.template.copy(),
    )
    frames.rotations[:, segment], frames.origins[:, segment], frames.known[:, segment] = r, o, known
    for m in (first, second):
        own = np.einsum("fba,fb->fa", r[known], now.places[known, m] - o[known])
        frames.template[m] = np.median(own, axis=0) if known.any() else 0.0
    return now._replace(frames=frames)
