"""Sequences of depth images of one or several cameras, loaded on demand."""

import glob
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from ...arguments import checked
from ...errors import InputError
from ...value_checks import check_positive
from ..archives.archive import array_names, load_arrays
from ..lazy_frames import LazyFrames
from ..meshes.point_files import is_organised, read_organised_depth
from ..system.paths import natural_sort_key, select_range
from ..system.reader_errors import reader_of
from ..text import shortened
from .images import DEPTH_ARRAYS, SUFFIXES, depths_in_metres, read_depth_image, read_mask
from .open_exr import EXR_SUFFIX, read_exr_depth
from .pairing import check_same_numbers, warn_of_gaps
from .recording import is_recording
from .recordings import open_recording

#: suffix of organised point clouds
ORGANISED = ".pcd"
#: suffixes of files with one depth image
DEPTH_SUFFIXES = (*SUFFIXES, EXR_SUFFIX, ORGANISED)
#: names of the array of masks in an `.npz`
_MASK_NAMES = ("mask", "masks")


class DepthFrame(NamedTuple):
    """The depth images of all cameras in one frame."""

    name: str
    #: metres along the optical axis; zero for pixels without measurement
    depths: tuple[Float[np.ndarray, "H W"], ...]
    #: the pixels of the person in each; None where they are not known
    masks: tuple[Bool[np.ndarray, "H W"] | None, ...]
    #: the image of each camera in messages; the frame's name where they are not known
    files: tuple[str, ...] = ()


@checked
@reader_of("depth images")
def read_depths(
    sources: str | Path | Sequence[str | Path],
    masks: str | Path | Sequence[str | Path] = (),
    first: int | None = None,
    last: int | None = None,
    depth_scale: float = 1000.0,
) -> LazyFrames[DepthFrame]:
    """Open sequences of depth images, one for each camera, with equally many frames.

    **Arguments:** each of the `sources` is a folder or a glob of 16-bit PNG or TIFF images, of OpenEXR images or of organised
    .pcd clouds, an `.npz` with the array `depth` or `depth_mm` (F, H, W), and optionally `mask` (F, H, W), or a recording of a
    RealSense or of ROS (`.bag`, `.db3`) or of an Azure Kinect (`.mkv`); `masks`, if they are known, likewise, as images;
    `first` and `last`, both included, count frames from 0; `depth_scale`, the number of the file's units in a metre.

    Images with the same position in their sequences are one frame. Numbers in their names have to agree.

    **Raises:** `InputError` if nothing is found, cameras have different numbers of frames, or images of one frame have
    different numbers in their names (`check_same_numbers`); also, when it is loaded, if an image is invalid.

    **Warns:** `UserWarning` if one sequence counts from 0 and another one from 1, or a few numbers are missing.
    """
    check_positive("read_depths", "units in a metre", depth_scale=depth_scale)
    cameras = [_open(source, depth_scale) for source in _listed(sources)]
    if not cameras:
        raise InputError("No depth images were given; give a folder, a glob or an .npz for each camera.")
    known = [_image_files(source) for source in _listed(masks)]
    if known and len(known) != len(cameras):
        raise InputError(
            f"There are masks of {len(known)} cameras, but depth images of {len(cameras)}; give masks of each camera."
        )
    warn_of_gaps(cameras[0].paths)
    for camera in cameras[1:]:
        check_same_numbers(cameras[0].paths, camera.paths)
    for camera, paths in zip(cameras, known, strict=False):
        check_same_numbers(camera.paths, paths)
    count = len(cameras[0].names)
    remedies = ["as many images of each camera"] * len(cameras) + ["as many masks as depth images"] * len(
        known
    )
    for names, remedy in zip((*(camera.names for camera in cameras), *known), remedies, strict=True):
        if len(names) != count:
            raise InputError(
                f"{names[0]}: this sequence has {len(names)} images, but {cameras[0].names[0]} has {count}; give {remedy}."
            )
    _check_simultaneous(cameras)
    chosen = select_range(list(range(count)), first, last, cameras[0].names[0])

    def load(number: int) -> DepthFrame:
        frame = chosen[number]
        shown = [camera.load(frame) for camera in cameras]
        people = [mask for _, mask in shown]
        if known:
            people = [read_mask(paths[frame]) for paths in known]
            for camera, paths, (depth, _), person in zip(cameras, known, shown, people, strict=True):
                _check_mask(person, paths[frame], depth, camera.names[frame])
        files = tuple(camera.names[frame] for camera in cameras)
        return DepthFrame(files[0], tuple(depth for depth, _ in shown), tuple(people), files)

    return LazyFrames([cameras[0].names[frame] for frame in chosen], load)


def read_depth_file(path: Path, depth_scale: float) -> Float[np.ndarray, "H W"]:
    """Read a file with one depth image by its suffix, metres. Raises `InputError`."""
    suffix = path.suffix.lower()
    if suffix == ORGANISED:
        return read_organised_depth(path)
    return read_exr_depth(path) if suffix == EXR_SUFFIX else read_depth_image(path, depth_scale)


def shows_organised_points(source: str | Path) -> bool:
    """Test if a file, or the first one of a folder or a glob, is a .pcd whose points are organised in rows of an image."""
    try:
        first = _image_files(source, DEPTH_SUFFIXES)[0]
    except InputError:
        return False
    return first.suffix.lower() == ORGANISED and is_organised(first)


class _Images(NamedTuple):
    """The images of one camera: loads depth and mask of a frame."""

    names: list[str]
    load: Callable[[int], tuple[np.ndarray, np.ndarray | None]]
    #: the time of each, seconds, if it is known
    times: Float[np.ndarray, "F"] | None = None
    #: the file of each, if each has one
    paths: Sequence[Path] = ()


def _check_simultaneous(cameras: Sequence[_Images]) -> None:
    """Check that frames of recordings with as many images were taken at one time: none has dropped another one.

    **Raises:** `InputError` for the first frame that is not.
    """
    times = [camera.times - camera.times[0] for camera in cameras if camera.times is not None]
    for other in times[1:]:
        difference = np.abs(other - times[0])
        steps = np.diff(times[0])
        dropped = np.flatnonzero(difference > 0.5 * np.median(steps)) if len(steps) else []
        if len(dropped):
            raise InputError(
                f"{cameras[0].names[dropped[0]]}: the cameras took this image {difference[dropped[0]]:.3f} s apart, counted from the first "
                "ones; a camera has dropped images. Cut the recordings there, or give images that were taken at one time."
            )


def _check_mask(mask: Bool[np.ndarray, "h w"], path: Path, depth: Float[np.ndarray, "H W"], of: str) -> None:
    """Check that a mask has the size of the depth image `of`. Raises `InputError`."""
    if mask.shape != depth.shape:
        raise InputError(
            f"{path}: the mask has {mask.shape[1]} x {mask.shape[0]} pixels, but the depth image {of} has "
            f"{depth.shape[1]} x {depth.shape[0]}; give masks of the size of the depth images."
        )


def _listed(sources: str | Path | Sequence[str | Path]) -> list[str | Path]:
    return [sources] if isinstance(sources, str | Path) else list(sources)


def _open(source: str | Path, depth_scale: float) -> _Images:
    path = Path(source)
    if path.suffix.lower() == ".npz" and not path.is_dir():
        return _stack(path, depth_scale)
    if is_recording(path) and not path.is_dir():
        recording = open_recording(path, depth_scale)
        return _Images(
            [f"{path}[{frame}]" for frame in range(len(recording.times))],
            lambda frame: (recording.load(frame), None),
            recording.times,
        )
    paths = _image_files(source, DEPTH_SUFFIXES)

    def load(frame: int):
        return read_depth_file(paths[frame], depth_scale), None

    return _Images([str(path) for path in paths], load, paths=paths)


def _image_files(source: str | Path, suffixes: tuple[str, ...] = SUFFIXES) -> list[Path]:
    path = Path(source)
    if path.is_dir():
        found = [one for one in path.iterdir() if one.suffix.lower() in suffixes]
    else:
        found = [Path(one) for one in glob.glob(str(source))]
    if not found:
        raise InputError(
            f"{source}: there are no images; give a folder, a glob such as 'cam0/*.png', or an .npz."
        )
    return sorted(found, key=natural_sort_key)


def _wrong_arrays(path: Path, depth: np.ndarray | None) -> InputError:
    """Make the error of an `.npz` whose array of depths is missing, or has another shape or type."""
    if depth is not None:
        found = f"the depths have the shape {depth.shape} and the type {depth.dtype}"
    else:
        names = ", ".join(shortened(name) for name in array_names(path)[:8])
        found = f"there is no array 'depth' among its arrays ({names or 'none'})"
    return InputError(
        f"{path}: {found}. Save depth images as an array 'depth' of numbers (F, H, W), also a single one."
    )


def _stack(path: Path, depth_scale: float) -> _Images:
    arrays = load_arrays(path, lambda name: name in (*DEPTH_ARRAYS, *_MASK_NAMES))
    depth = next((arrays[name] for name in DEPTH_ARRAYS if name in arrays), None)
    mask = next((arrays[name] for name in _MASK_NAMES if name in arrays), None)
    if depth is None or depth.ndim != 3 or depth.dtype.kind not in "fiu":
        raise _wrong_arrays(path, depth)
    if mask is not None and mask.shape != depth.shape and mask.dtype == np.uint8:
        # eight pixels of a row in a byte
        mask = np.unpackbits(mask, axis=-1, count=depth.shape[-1])
    if mask is not None and mask.shape != depth.shape:
        raise InputError(f"{path}: 'mask' has the shape {mask.shape}; expected {depth.shape}, as 'depth'.")

    def load(frame: int):
        return depths_in_metres(depth[frame], depth_scale), None if mask is None else mask[frame] > 0

    return _Images([f"{path}[{frame}]" for frame in range(len(depth))], load)
