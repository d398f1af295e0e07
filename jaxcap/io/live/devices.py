"""Depth cameras that are connected to this computer, by the packages of their makers."""

import importlib
import threading
import time
from collections.abc import Iterator
from types import ModuleType
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from ...errors import InputError
from ...geometry.camera import Camera
from ..depth.intrinsics import FORWARD
from ..depth.sequence import DepthFrame
from .arrivals import Arrival

#: packages of the cameras by the names of `open_device`
PACKAGES = {"realsense": "pyrealsense2", "orbbec": "pyorbbecsdk"}
#: milliseconds for which one frame is waited for
TIMEOUT_MS = 1000


class Device(NamedTuple):
    """A depth camera that is started: its intrinsics, and its frames."""

    camera: Camera
    frames: Iterator[Arrival]


def open_device(
    name: str, stop: threading.Event, resolution: tuple[int, int] = (640, 480), rate: int = 30
) -> Device:
    """Start a connected depth camera, `realsense` or `orbbec`; its frames end with `stop`.

    The camera is at the origin and looks along -z, with y up.

    **Raises:** `InputError` if the package of the camera is not installed, no camera is connected, or it has no such images.
    """
    package = _import(name)
    try:
        return {"realsense": _open_realsense, "orbbec": _open_orbbec}[name](package, stop, resolution, rate)
    except InputError:
        raise
    except Exception as error:  # any error of the package, often without a class of its own
        width, height = resolution
        raise InputError(
            f"{name}: the camera cannot be started with {width} x {height} pixels at {rate} frames per second ({error}); "
            "connect it, and close other programs that use it."
        ) from None


def _import(name: str) -> ModuleType:
    try:
        return importlib.import_module(PACKAGES[name])
    except ImportError:
        raise InputError(
            f"{name}: the package {PACKAGES[name]} of this camera is not installed; install it with "
            f"pip install {PACKAGES[name]}."
        ) from None


def _open_realsense(rs: Any, stop: threading.Event, resolution: tuple[int, int], rate: int) -> Device:
    """Start a RealSense camera. Its depth images are rectified by the camera itself."""
    pipeline, config = rs.pipeline(), rs.config()
    config.enable_stream(rs.stream.depth, *resolution, rs.format.z16, rate)
    profile = pipeline.start(config)
    scale = float(profile.get_device().first_depth_sensor().get_depth_scale())
    inner = profile.get_stream(rs.stream.depth).as_video_stream_profile().get_intrinsics()

    def frames() -> Iterator[Arrival]:
        number = 0
        try:
            while not stop.is_set():
                arrived, frame = pipeline.try_wait_for_frames(TIMEOUT_MS)
                if not arrived:
                    continue
                image = frame.get_depth_frame()
                depth = np.asanyarray(image.get_data()) * scale
                yield _arrival("realsense", number, float(image.get_timestamp()) / 1000.0, depth)
                number += 1
        finally:
            pipeline.stop()

    return Device(_camera(inner.fx, inner.fy, inner.ppx, inner.ppy, inner.width, inner.height), frames())


def _open_orbbec(ob: Any, stop: threading.Event, resolution: tuple[int, int], rate: int) -> Device:
    """Start an Orbbec camera."""
    pipeline, config = ob.Pipeline(), ob.Config()
    profiles = pipeline.get_stream_profile_list(ob.OBSensorType.DEPTH_SENSOR)
    profile = profiles.get_video_stream_profile(*resolution, ob.OBFormat.Y16, rate)
    config.enable_stream(profile)
    pipeline.start(config)
    inner = pipeline.get_camera_param().depth_intrinsic

    def frames() -> Iterator[Arrival]:
        number = 0
        try:
            while not stop.is_set():
                found = pipeline.wait_for_frames(TIMEOUT_MS)
                image = None if found is None else found.get_depth_frame()
                if image is None:
                    continue
                units = np.frombuffer(image.get_data(), np.uint16).reshape(
                    image.get_height(), image.get_width()
                )
                depth = units * (float(image.get_depth_scale()) / 1000.0)
                yield _arrival("orbbec", number, float(image.get_timestamp()) / 1000.0, depth)
                number += 1
        finally:
            pipeline.stop()

    return Device(_camera(inner.fx, inner.fy, inner.cx, inner.cy, inner.width, inner.height), frames())


def _camera(fx: float, fy: float, cx: float, cy: float, width: int, height: int) -> Camera:
    return Camera(
        jnp.asarray(FORWARD),
        jnp.zeros(3),
        jnp.asarray([fx, fy]),
        jnp.asarray([cx, cy]),
        int(width),
        int(height),
    )


def _arrival(name: str, number: int, seconds: float, depth: np.ndarray) -> Arrival:
    frame = DepthFrame(f"{name}[{number}]", (depth,), (None,))
    return Arrival(frame.name, seconds, time.monotonic(), lambda: frame)
