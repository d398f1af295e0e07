"""Opening of recordings of depth cameras, each by its library."""

from pathlib import Path

from ...errors import InputError
from .recording import LIBRARIES, Recording


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
