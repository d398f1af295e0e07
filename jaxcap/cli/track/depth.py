"""The frames of depth images as clouds of the person, read on access."""

from collections.abc import Sequence
from pathlib import Path
from typing import overload

from ...body.body import Body
from ...depth.clouds import cloud_of_depths
from ...errors import InputError
from ...fit.tracking.check import check_cloud
from ...geometry.camera import Camera
from ...io.cameras import read_cameras
from ...io.depth.sequence import DepthFrames, read_depths
from ...observe.clouds import Cloud
from ..console.options import Up
from ..sources import upright_camera


class DepthClouds(Sequence):
    """Clouds of the person in depth images, with what their cameras saw, y up."""

    def __init__(self, frames: DepthFrames, cameras: Sequence[Camera], body: Body):
        self._frames, self._cameras, self._body = frames, tuple(cameras), body

    @property
    def names(self) -> tuple[str, ...]:
        """The name of each frame."""
        return self._frames.names

    @property
    def num_cameras(self) -> int:
        """The number of cameras."""
        return len(self._cameras)

    def __len__(self) -> int:
        return len(self._frames)

    @overload
    def __getitem__(self, index: int) -> Cloud: ...
    @overload
    def __getitem__(self, index: slice) -> "DepthClouds": ...
    def __getitem__(self, index):
        if isinstance(index, slice):
            return DepthClouds(self._frames[index], self._cameras, self._body)
        frame = self._frames[index]
        cloud = cloud_of_depths(self._cameras, frame.depths, frame.masks, name=frame.name)
        check_cloud(self._body, cloud, frame.name)
        return cloud


def load_depth_clouds(
    depths: Sequence[str],
    cameras: Path | None,
    masks: Sequence[str],
    scale: float,
    frames: tuple[int | None, int | None],
    body: Body,
    up: Up,
) -> DepthClouds:
    """Open depth images with their cameras.

    **Arguments:** `scale`, units of the images in a metre; `frames`, first and last, both included; `up`, the vertical
    of the cameras' world.

    **Raises:** `InputError` if there are no cameras, or another number of them than of sequences.
    """
    if cameras is None:
        raise InputError(
            "--depth needs the intrinsics of the camera; give them with --cameras, .json as written by `jaxcap scan`, "
            "Open3D, RealSense or OpenCV."
        )
    known = [upright_camera(camera, up) for camera in read_cameras(cameras)]
    if len(known) != len(depths):
        raise InputError(
            f"{cameras}: there are {len(known)} cameras, but --depth names {len(depths)} sequences of images; give a "
            "folder, a quoted glob such as 'cam0/*.png', or an .npz for each camera."
        )
    return DepthClouds(read_depths(list(depths), list(masks), *frames, depth_scale=scale), known, body)
