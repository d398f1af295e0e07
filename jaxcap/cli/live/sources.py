"""The sources of `jaxcap live`: folders that grow, standard input, depth cameras, and recorded frames."""

import functools
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ...errors import InputError
from ...geometry.camera import Camera
from ...io.depth.recording import is_recording
from ...io.depth.rectify import make_rectifier
from ...io.depth.sequence import DepthFrame, read_depths
from ...io.lazy_frames import LazyFrames
from ...io.live.array_stream import read_array_stream
from ...io.live.arrivals import Arrival, replay
from ...io.live.devices import PACKAGES, open_device
from ...io.live.growing_folder import watch_cloud_folder, watch_depth_folders
from ...io.meshes.clouds import read_clouds
from ...live.live_tracker import Observation
from ...observe.clouds import Scan
from ..console.options import Up
from ..depth.sources import read_depth_cameras
from ..sources import up_rotation, upright_camera

#: the name of standard input
PIPE = "-"


class Source(NamedTuple):
    """The frames of a source, and its cameras if it has depth images."""

    arrivals: Iterator[Arrival]
    #: without lenses
    cameras: list[Camera]
    #: the same cameras as they recorded
    recorded: list[Camera]
    #: reads a frame for the compilation, if one is there before the first arrives
    sample: Callable[[], DepthFrame | Scan] | None = None


def open_source(
    watch: Sequence[str],
    cameras: Path | None,
    replay_rate: float | None,
    depth_scale: float,
    unit: str,
    up: Up,
    timeout: float | None,
    stop: threading.Event,
) -> Source:
    """Open the source of a live run. The cameras have y up.

    **Raises:** `InputError` for a source that does not exist, or cameras that do not fit it.
    """
    name = watch[0]
    is_recorded = all(map(is_recording, watch))
    own = [] if cameras is None and not is_recorded else read_depth_cameras(watch, cameras, "--watch", up)
    known, rectify = make_rectifier(own)
    if name in PACKAGES:
        _check_alone(watch, replay_rate)
        device = open_device(name, stop)
        if not known:
            own = [upright_camera(device.camera, up)]
            known, rectify = make_rectifier(own)
        return Source(_rectified(device.frames, rectify), known, own)
    if name == PIPE:
        _check_alone(watch, replay_rate)
        frames = read_array_stream(sys.stdin.buffer, "standard input", depth_scale, stop)
        return Source(_rectified(frames, rectify), known, own)
    if known and len(known) != len(watch):
        raise InputError(
            f"{cameras}: there are {len(known)} cameras, but --watch names {len(watch)} sources; give one for each camera."
        )
    if not known and len(watch) > 1:
        raise InputError(
            f"--watch names {len(watch)} sources of clouds; give one, or --cameras for depth images."
        )
    if replay_rate is not None:
        recorded: LazyFrames[DepthFrame] | LazyFrames[Scan] = (
            read_depths(list(watch), depth_scale=depth_scale) if known else read_clouds(name, unit=unit)
        )
        sample = functools.partial(_read, lambda: recorded[0], rectify)
        return Source(_rectified(replay(recorded, replay_rate, stop), rectify), known, own, sample)
    if not all(Path(one).is_dir() for one in watch):
        raise InputError(
            f"{next(one for one in watch if not Path(one).is_dir())}: this is no folder to watch; make it, or give "
            "--replay RATE for recorded frames, '-' for standard input, or realsense or orbbec."
        )
    arrivals = (
        watch_depth_folders(watch, depth_scale, stop, timeout)
        if known
        else watch_cloud_folder(name, unit, stop, timeout)
    )
    return Source(_rectified(arrivals, rectify), known, own)


def _rectified(arrivals: Iterator[Arrival], rectify: Callable[[DepthFrame], DepthFrame]) -> Iterator[Arrival]:
    """Rectify the depth images of arrivals when they are read."""
    return (arrival._replace(read=functools.partial(_read, arrival.read, rectify)) for arrival in arrivals)


def _read(
    read: Callable[[], DepthFrame | Scan], rectify: Callable[[DepthFrame], DepthFrame]
) -> DepthFrame | Scan:
    frame = read()
    return rectify(frame) if isinstance(frame, DepthFrame) else frame


def _check_alone(watch: Sequence[str], replay_rate: float | None) -> None:
    """Check that standard input, or a camera, is the only source, and is not replayed. Raises `InputError`."""
    if len(watch) > 1:
        raise InputError(f"--watch {watch[0]} is a source by itself; remove {', '.join(watch[1:])}.")
    if replay_rate is not None:
        raise InputError(
            f"--replay is for recorded files; remove it, as frames of {watch[0]} have their own rate."
        )


def observation(frame: DepthFrame | Scan, up: Up) -> Observation:
    """Convert a frame to what a `LiveTracker` takes, with y up."""
    if isinstance(frame, DepthFrame):
        return list(frame.depths)
    turn = up_rotation(up)
    normals = None if frame.normals is None else frame.normals @ turn.T
    return Scan(frame.name, np.asarray(frame.points @ turn.T), normals, frame.faces)
