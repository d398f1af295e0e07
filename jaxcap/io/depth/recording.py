"""A recording of a depth camera: one file with the images and the intrinsics."""

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from ...geometry.camera import Camera

#: the library that reads each kind of recording, by its suffix
LIBRARIES = {".bag": "rosbags", ".db3": "rosbags", ".mkv": "av"}
RECORDING_SUFFIXES = tuple(LIBRARIES)


class Recording(NamedTuple):
    """The depth images of one camera."""

    #: at the origin, looking along -z, with y up
    camera: Camera
    #: the time of each image, seconds
    times: Float[ndarray, "F"]
    #: loads the depth image of a frame, metres, zero where nothing was measured
    load: Callable[[int], Float[ndarray, "H W"]]


def recorded_rate(recording: Recording) -> float | None:
    """Compute the frames per second of a recording; None if it has fewer than two, or their times do not increase.

    Intervals that are much longer than the median, in which images were dropped, do not count.
    """
    steps = np.diff(recording.times)
    steps = steps[steps > 0]
    if not len(steps):
        return None
    usual = steps[steps < 1.5 * np.median(steps)]
    return round(1.0 / float(usual.mean()), 2)


def is_recording(path: str | Path) -> bool:
    """Test by its suffix if a file is a recording of a depth camera."""
    return Path(path).suffix.lower() in RECORDING_SUFFIXES
