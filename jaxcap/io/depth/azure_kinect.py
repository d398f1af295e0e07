"""Recordings of the Azure Kinect (.mkv), by PyAV."""

import json
import threading
from pathlib import Path
from typing import Any

import av
import jax.numpy as jnp
import numpy as np
from av.error import FFmpegError
from jaxtyping import Float

from ...errors import InputError
from ...geometry.camera import Camera
from ...geometry.lens import Lens
from .intrinsics import FORWARD
from .recording import Recording

#: names of the track of depth and of the attached calibration
DEPTH_TRACK, CALIBRATION = "DEPTH", "calibration.json"
#: model of lenses of all sold cameras
BROWN_CONRADY = "CALIBRATION_LensDistortionModelBrownConrady"
#: width and height of the images of each depth mode: side of the square image of the sensor, and the first column and
#: row that are kept of it (the SDK's `mode_specific_calibration.c`)
DEPTH_MODES = {
    (640, 576): (1024, 192, 180),
    (320, 288): (512, 96, 90),
    (512, 512): (512, 0, 0),
    (1024, 1024): (1024, 0, 0),
}
#: units of depth in a metre
UNITS = 1000.0


def open_azure_kinect(path: Path) -> Recording:
    """Open a recording of an Azure Kinect, as its recorder `k4arecorder` writes them.

    **Raises:** `InputError` if the file is no Matroska file, or has no track of depth or no calibration.
    """
    try:
        container = av.open(str(path))
    except (FFmpegError, ValueError) as error:
        raise InputError(f"{path}: this cannot be read as a video ({error}); record it again.") from None
    track = next((one for one in container.streams.video if one.metadata.get("title") == DEPTH_TRACK), None)
    if track is None:
        raise InputError(
            f"{path}: the video has no track of depth; poses are not estimated from colour images. Record with a depth mode "
            "(`k4arecorder -d NFOV_UNBINNED`)."
        )
    size = track.codec_context.width, track.codec_context.height
    attached = next((s for s in container.streams if s.type == "attachment" and s.name == CALIBRATION), None)
    if attached is None:
        raise InputError(
            f"{path}: the recording has no calibration; export its depth images, and give --cameras."
        )
    data: bytes = attached.data  # pyright: ignore[reportAttributeAccessIssue]
    camera = _camera(bytes(data), size, str(path))
    try:
        times = sorted(packet.pts for packet in container.demux(track) if packet.pts is not None)
    except FFmpegError as error:
        raise InputError(f"{path}: the recording is damaged ({error}); record it again.") from None
    if not times:
        raise InputError(f"{path}: the track of depth has no images; record it again.")
    return Recording(
        camera, np.array(times) * float(track.time_base or 0.001), _Frames(path, container, track, times)
    )


class _Frames:
    """Loads the images of a track: the next one by decoding on, others after a search for their time."""

    def __init__(self, path: Path, container: Any, track: Any, times: list[int]):
        self.path, self.container, self.track, self.times = path, container, track, times
        self.lock, self.next, self.decoded = threading.Lock(), -1, iter(())

    def __call__(self, frame: int) -> Float[np.ndarray, "H W"]:
        with self.lock:
            try:
                if frame != self.next:
                    self.container.seek(self.times[frame], stream=self.track)
                    self.decoded = self.container.decode(self.track)
                image = next(one for one in self.decoded if one.pts == self.times[frame]).to_ndarray()
            except (FFmpegError, StopIteration, ValueError) as error:
                self.next = -1
                raise InputError(
                    f"{self.path}[{frame}]: the image cannot be decoded ({error}); record it again."
                ) from None
            self.next = frame + 1
            if image.ndim != 2 or image.dtype != np.uint16:
                raise InputError(
                    f"{self.path}[{frame}]: the image has no depths of 16 bits; record it again."
                )
            return image / UNITS


def _camera(calibration: bytes, size: tuple[int, int], where: str) -> Camera:
    """Make the camera of the images of a depth mode from the calibration of the sensor."""
    if size not in DEPTH_MODES:
        raise InputError(
            f"{where}: the depth images have {size[0]} x {size[1]} pixels, which no depth mode has."
        )
    try:
        content = json.loads(calibration.rstrip(b"\0"))
        cameras = content["CalibrationInformation"]["Cameras"]
        depth = next(one for one in cameras if str(one["Location"]).endswith("D0"))
        model = depth["Intrinsics"]["ModelType"]
        numbers = np.asarray(depth["Intrinsics"]["ModelParameters"], float)[:14]
        cx, cy, fx, fy, k1, k2, k3, k4, k5, k6, codx, cody, p2, p1 = numbers
    except (ValueError, KeyError, TypeError, StopIteration) as error:
        raise InputError(
            f"{where}: the attached calibration has no intrinsics of the depth camera ({error}); record it again."
        ) from None
    if model != BROWN_CONRADY or codx or cody:
        raise InputError(
            f"{where}: the calibration is of the model {model}, which only prototypes of the camera have; export its depth "
            "images without distortion, and give --cameras."
        )
    if not (np.isfinite(numbers).all() and min(fx, fy) > 0):
        raise InputError(
            f"{where}: the attached calibration has numbers that are not finite; record it again."
        )
    side, column, row = DEPTH_MODES[size]
    # relative to the sensor's size, counted from the corner of its first pixel
    middle = [cx * side - column - 0.5, cy * side - row - 0.5]
    lens = Lens(jnp.asarray([k1, k2, p1, p2, k3, k4, k5, k6]))
    return Camera(
        jnp.asarray(FORWARD),
        jnp.zeros(3),
        jnp.asarray([fx * side, fy * side]),
        jnp.asarray(middle),
        *size,
        lens,
    )
