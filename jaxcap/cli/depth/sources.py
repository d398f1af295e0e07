"""Depth images with their cameras, and the backgrounds behind the person."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal, NamedTuple

from ...depth.background import MAX_FRAMES, Background, estimate_background
from ...errors import InputError
from ...geometry.camera import Camera
from ...geometry.sampling import even_indices
from ...io.cameras import read_cameras
from ...io.depth.recording import RECORDING_SUFFIXES, is_recording
from ...io.depth.rectify import rectify_depths
from ...io.depth.sequence import DepthFrame, read_depths
from ...io.lazy_frames import LazyFrames
from ..console.heartbeat import set_activity
from ..console.options import DepthSpec, OptionalFile, Up, arg
from ..sources import upright_camera

#: options of several verbs
Cameras = Annotated[
    OptionalFile,
    arg(
        help="Cameras of the depth images, .json: intrinsics as written by Open3D, RealSense or OpenCV, or calibrated cameras "
        "as written by `jaxcap scan`. Recordings (.bag, .db3, .mkv) contain their own."
    ),
]
Masks = Annotated[
    DepthSpec,
    arg(
        help="Masks of the person in the depth images: for each camera a folder or a quoted glob. The person is where a mask is "
        "not zero."
    ),
]
Empty = Annotated[
    DepthSpec,
    arg(
        help="Depth images that show nobody, for each camera a source as for --depth: the background. Without them the "
        "background is estimated from what never moves in the sequence."
    ),
]
DepthScale = Annotated[
    float,
    arg(
        help="Number of units of the depth images in one metre: 1000 if they are in millimetres. It applies to whole numbers; "
        "other depths are in metres."
    ),
]
BackgroundChoice = Annotated[
    Literal["auto", "never"],
    arg(
        help="Estimate the background from what never moves in the sequence, if neither --empty nor masks are given (auto), or "
        "never."
    ),
]


class DepthSources(NamedTuple):
    """The images of all cameras, read on access."""

    #: y up, without lenses, as the images
    cameras: list[Camera]
    #: the same cameras as they recorded
    recorded: list[Camera]
    images: LazyFrames[DepthFrame]
    #: one source for each camera, as the user named it
    names: tuple[str, ...]


def open_depth_sources(
    depths: Sequence[str],
    cameras: Path | None,
    masks: Sequence[str],
    scale: float,
    frames: tuple[int | None, int | None] = (None, None),
    up: Up = "y",
) -> DepthSources:
    """Open depth images with their cameras, y up, without the distortion of lenses.

    **Arguments:** `cameras`, not needed for recordings, which contain them; `scale`, units of the images in a metre; `frames`, first
    and last, both included; `up`, the vertical of the cameras' world.

    **Raises:** `InputError` if there are no cameras, or another number of them than of sequences.
    """
    known = read_depth_cameras(depths, cameras, "--depth", up)
    if len(known) != len(depths):
        raise InputError(
            f"{cameras}: there are {len(known)} cameras, but --depth names {len(depths)} sequences of images; give a "
            "folder, a quoted glob such as 'cam0/*.png', or an .npz for each camera."
        )
    images = read_depths(list(depths), list(masks), *frames, depth_scale=scale)
    rectified, images = rectify_depths(known, images)
    return DepthSources(rectified, known, images, tuple(depths))


def read_depth_cameras(depths: Sequence[str], cameras: Path | None, option: str, up: Up) -> list[Camera]:
    """Read the cameras of depth images, y up: those of recordings from these, if there is no file of cameras.

    **Raises:** `InputError`, which names the `option` of the images, if there are no cameras.
    """
    if cameras is None and not all(map(is_recording, depths)):
        raise InputError(
            f"{option} needs the intrinsics of the camera; give them with --cameras, .json as written by `jaxcap scan`, "
            f"Open3D, RealSense or OpenCV. Only recordings ({', '.join(RECORDING_SUFFIXES)}) contain them."
        )
    paths = depths if cameras is None else [cameras]
    return [upright_camera(camera, up) for path in paths for camera in read_cameras(path)]


def read_empty(
    cameras: Sequence[Camera], recorded: Sequence[Camera], empty: Sequence[str], scale: float
) -> list[Background | None]:
    """Read the backgrounds of all cameras from images that show nobody.

    **Arguments:** `cameras`, without lenses; `recorded`, the same cameras as they recorded; `empty`, a source of images for each;
    `scale`, units of the images in a metre.

    **Raises:** `InputError` for another number of sources than of cameras, or images that do not fit.
    """
    if len(empty) != len(cameras):
        raise InputError(
            f"--empty names {len(empty)} sequences of images, but there are {len(cameras)} cameras; give empty frames of each "
            "camera."
        )
    set_activity("reading the empty frames")
    found: list[Background | None] = []
    for camera, original, source in zip(cameras, recorded, empty, strict=True):
        _, images = rectify_depths([original], read_depths(source, depth_scale=scale))
        depths = [
            images[number].depths[0]
            for number in even_indices(len(images), MAX_FRAMES, nearest=True).tolist()
        ]
        found.append(estimate_background(camera, depths, empty=True, where=source))
    return found


def choose_frames(sources: DepthSources) -> list[int]:
    """Choose frames for the background of the sequence itself; none if the person is known."""
    numbers = even_indices(len(sources.images), MAX_FRAMES, nearest=True).tolist()
    try:
        known = all(mask is not None for mask in sources.images[0].masks)
    except InputError:
        # tracking reports it
        return []
    return [] if known else numbers


def estimate_backgrounds(sources: DepthSources, numbers: Sequence[int]) -> list[Background | None]:
    """Estimate the backgrounds of all cameras from some frames of the sequence; None without frames.

    Images that cannot be read, or of another size, are left out: tracking reports them when their turn comes.
    """
    nothing: list[Background | None] = [None] * len(sources.cameras)
    if not numbers:
        return nothing
    set_activity("estimating the background")
    frames = []
    for number in numbers:
        try:
            frames.append(sources.images[number].depths)
        except InputError:
            continue
    if not frames:
        return nothing
    return [
        estimate_background(camera, [images[number] for images in frames], where=sources.names[number])
        for number, camera in enumerate(sources.cameras)
    ]


def describe_doubts(backgrounds: Sequence[Background | None]) -> list[str]:
    """List what the backgrounds do not show, a sentence for each camera, without full stops."""
    several = len(backgrounds) > 1
    return [
        f"the background{f' of camera {number}' if several else ''} is not known: {one.doubt}"
        for number, one in enumerate(backgrounds)
        if one is not None and one.doubt
    ]
