"""The frames of depth images as clouds of the person, read on access."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float

from ...body.body import Body
from ...depth.clouds import cloud_of_depths
from ...depth.people import find_people
from ...errors import InputError
from ...fit.tracking.check_cloud import check_cloud
from ...geometry.camera import Camera
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
    people: int | None = None,
    others: set[int] | None = None,
) -> LazyFrames[Cloud]:
    """Open depth images as clouds of the person with their depth images, y up.

    **Arguments:** `scale`, units of the images in a metre; `frames`, first and last, both included; `up`, the vertical
    of the cameras' world; `people`, the largest number of people whose points are kept, those of one where not given;
    `others`, a set to which the numbers of frames are added that show a second person, if one is looked for.

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
        masks = [
            mask if mask is not None or people is None else mask_people(camera, depth, people, frame.name)
            for camera, depth, mask in zip(known, frame.depths, frame.masks, strict=True)
        ]
        cloud = cloud_of_depths(known, frame.depths, masks, name=frame.name)
        if others is not None and any(
            mask is None and len(find_people(camera, depth, 2, frame.name)) > 1
            for camera, depth, mask in zip(known, frame.depths, masks, strict=True)
        ):
            others.add(number)
        check_cloud(body, cloud, frame.name)
        return cloud

    return LazyFrames(images.names, load)


def mask_people(
    camera: Camera, depth: Float[np.ndarray, "H W"], count: int, where: str
) -> Bool[np.ndarray, "H W"]:
    """Find the pixels of at most `count` people."""
    return np.any(find_people(camera, depth, count, where), axis=0)
