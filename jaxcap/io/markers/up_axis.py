"""The up axis of a marker file, from its header or from the positions of its markers."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from ...observe.markers import MarkerFrames
from .marker_file import MarkerFile, frame_sides

#: smallest height of a standing person's markers, metres, and its smallest ratio to the other sides
MIN_HEIGHT, MIN_RATIO = 0.8, 1.5
#: largest depth of markers below the floor, relative to their height
MAX_DEPTH = 0.1
#: share of marker positions that are left out at each end as outliers
OUTLIERS = 0.01


class UpAxis(NamedTuple):
    """The up axis of a file, and its source."""

    #: such as "z" or "-y"
    axis: str
    #: whether the header states the axis; otherwise it is only likely
    is_stated: bool


def find_up_axis(file: MarkerFile) -> UpAxis | None:
    """Find the up axis of a marker file: that of its header, or that along which the markers are those of a
    standing person.

    Files of some programs have the axis of the header with the wrong sign. So if all markers are on one side of
    the origin, as above a floor, this side is up. None if the axis is unknown.
    """
    letter = file.up[-1:] or _long_axis(file.frames)
    if not letter:
        return None
    side = _side_of_floor(file.frames, "xyz".index(letter))
    if side is None and not file.up:
        return None
    sign = file.up[:-1] if side is None else "-" if side < 0 else ""
    return UpAxis(f"{sign}{letter}", bool(file.up))


def _long_axis(frames: MarkerFrames) -> str:
    """Return the axis along which the markers of a frame extend by far the most; "" if there is none."""
    sides: Float[np.ndarray, "N 3"] = frame_sides(frames)
    if not len(sides):
        return ""
    median = np.median(sides, axis=0)
    second, first = np.argsort(median)[1:]
    if median[first] < max(MIN_HEIGHT, MIN_RATIO * median[second]):
        return ""
    return "xyz"[first]


def _side_of_floor(frames: MarkerFrames, axis: int) -> int | None:
    """Return the sign of the coordinates of nearly all markers along an axis; None if they have both signs."""
    heights = np.asarray(frames.positions, float)[np.asarray(frames.visible)][:, axis]
    low, high = np.quantile(heights, [OUTLIERS, 1 - OUTLIERS])
    if low >= -MAX_DEPTH * high:
        return 1
    return -1 if -high >= MAX_DEPTH * low else None
