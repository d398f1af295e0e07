"""The frames of depth images as clouds of the person, read on access."""

from collections.abc import Sequence
from pathlib import Path

from ...body.body import Body
from ...depth.clouds import cloud_of_depths
from ...errors import InputError
from ...fit.tracking.check_cloud import check_cloud
from ...io.cameras import read_cameras
from ...io.depth.sequence import read_depths
from ...io.lazy_frames import LazyFrames
from ...observe.clouds import Cloud
from ..console.options import Up
from ..sources import upright_camera


def load_depth_clouds(
    depths: Sequence[str],
    cameras: Path | None,
    masks: Sequence[str],
    scale: float,
    frames: tuple[int | None, int | None],
    body: Body,
    up: Up,
) -> LazyFrames[Cloud]:
    """Open depth images as clouds of the person with their depth images, y up.

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
    images = read_depths(list(depths), list(masks), *frames, depth_scale=scale)

    def load(number: int) -> Cloud:
        frame = images[number]
        cloud = cloud_of_depths(known, frame.depths, frame.masks, name=frame.name)
        check_cloud(body, cloud, frame.name)
        return cloud

    return LazyFrames(images.names, load)
