"""Recordings of depth cameras: one file with the images and the intrinsics."""

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from ...errors import InputError
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


def open_recording(path: str | Path, depth_scale: float = 1000.0) -> Recording:
    """Open a recording: `.bag` or `.db3` of a RealSense or of ROS, or `.mkv` of an Azure Kinect.

    **Arguments:** `depth_scale`, the number of units in a metre in a recording of ROS; those of cameras contain theirs.

    **Raises:** `InputError` if the library that reads it is not installed, or it has no depth images or no intrinsics.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError(f"{path}: there is no such file; check the path.")
    suffix = path.suffix.lower()
    try:
        if suffix == ".mkv":
            from .azure_kinect import open_azure_kinect

            return open_azure_kinect(path)
        from .ros_recording import open_ros_recording

        return open_ros_recording(path, depth_scale)
    except ImportError:
        raise InputError(
            f"{path}: reading {suffix} needs the library {LIBRARIES[suffix]}, which is not installed; run "
            "pip install -e '.[recordings]' in a checkout of jaxcap."
        ) from None
