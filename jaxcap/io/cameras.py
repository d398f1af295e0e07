"""Camera calibrations as `.json`, one object for each camera."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ..arguments import checked
from ..errors import InputError
from ..geometry.camera import MIN_SIDE_PIXELS, Camera, check_image_size
from .depth.camera_keys import incomplete_error, list_intrinsics
from .depth.intrinsics import cameras_of_intrinsics, is_rotation, make_lens
from .depth.recording import is_recording
from .depth.recordings import open_recording
from .kinds import check_kind
from .system.reader_errors import reader_of
from .table import write_json
from .text import MAX_NUMBER, read_json, shortened

FORMAT = "jaxcap cameras"
#: arrays of each camera, with their shapes
_ARRAY_SHAPES = {"rotation": (3, 3), "translation": (3,), "focal": (2,), "principal_point": (2,)}
_SIZES = ("width", "height")
#: largest distance of a camera from the origin, metres
MAX_DISTANCE = 100.0


@checked
def write_cameras(path: str | Path, cameras: Sequence[Camera]) -> None:
    """Write camera calibrations for `read_cameras`, in metres and pixels.

    **Raises:** `InputError` if the file cannot be written.
    """
    rows = [
        {name: np.asarray(getattr(camera, name), float).tolist() for name in _ARRAY_SHAPES}
        | {name: getattr(camera, name) for name in _SIZES}
        | _lens_row(camera)
        for camera in cameras
    ]
    write_json(path, {"format": FORMAT, "version": 1, "cameras": rows})


@checked
@reader_of("a camera calibration")
def read_cameras(path: str | Path) -> list[Camera]:
    """Read camera calibrations from JSON.

    The format is `{"cameras": [{"rotation", "translation", "focal", "principal_point", "width", "height"},
    ...]}`. Transforms are from the world to the camera, in metres and pixels; see `Camera`. A single focal
    length applies to both axes. `distortion` and `distortion_model` describe a lens, see `Lens`.

    Intrinsics of one camera as Open3D, RealSense and OpenCV write them are read too, and those in a recording
    (`.bag`, `.db3`, `.mkv`): the camera is at the origin and looks along -z, with y up. A list of such objects, each with
    the `extrinsic` of Open3D, has several cameras.

    **Raises:** `InputError` if there is no such file, it is not JSON, or it has no cameras; also if a camera
    lacks a key, or has numbers that are not finite, an invalid rotation or an invalid image size. The message
    gives the number of the camera.
    """
    if is_recording(path):
        return [open_recording(path).camera]
    check_kind(path, "cameras", (".json",))
    content = read_json(path)
    if intrinsics := list_intrinsics(content):
        cameras = cameras_of_intrinsics(intrinsics, str(path))
        for number, camera in enumerate(cameras):
            _check_distance(camera, f"{path}: camera {number}" if len(cameras) > 1 else f"{path}: the camera")
        return cameras
    rows = content.get("cameras") if isinstance(content, dict) else None
    if not isinstance(rows, list) or not rows:
        raise incomplete_error(str(path), "the file has no list 'cameras' and no intrinsics")
    return [_camera(row, f"{path}: camera {number}") for number, row in enumerate(rows)]


def _check_distance(camera: Camera, where: str) -> None:
    """Check that the distance of a camera from the origin can be in metres. Raises `InputError`."""
    distance = float(np.linalg.norm(camera.translation))
    if distance > MAX_DISTANCE:
        raise InputError(
            f"{where} is {distance:.4g} m from the origin; expected at most {MAX_DISTANCE:g} m. Translations are in metres: divide "
            "millimetres by 1000, or move the origin to the cameras."
        )


def _camera(row: object, where: str) -> Camera:
    if not isinstance(row, dict):
        raise InputError(
            f"{where} is not an object with keys; write its {', '.join((*_ARRAY_SHAPES, *_SIZES))}."
        )
    missing = [name for name in (*_ARRAY_SHAPES, *_SIZES) if name not in row]
    if missing:
        raise InputError(f"{where} has no '{missing[0]}'; write its {', '.join((*_ARRAY_SHAPES, *_SIZES))}.")
    arrays = {name: _numbers(row[name], name, shape, where) for name, shape in _ARRAY_SHAPES.items()}
    sizes = {name: row[name] for name in _SIZES}
    for name, size in sizes.items():
        if not isinstance(size, int) or isinstance(size, bool) or size < MIN_SIDE_PIXELS:
            raise InputError(
                f"{where}: '{name}' is {shortened(repr(size))}; expected a whole number of pixels, at least {MIN_SIDE_PIXELS}."
            )
    check_image_size(sizes["width"], sizes["height"], where)
    if not is_rotation(arrays["rotation"]):
        raise InputError(
            f"{where}: 'rotation' is not a rotation matrix; expected rows that are orthonormal and "
            "right-handed."
        )
    if (arrays["focal"] <= 0).any():
        raise InputError(f"{where}: 'focal' is not above zero; give focal lengths in pixels.")
    lens = make_lens(row.get("distortion", []), str(row.get("distortion_model", "")), where)
    camera = Camera(**arrays, **sizes, lens=lens)
    _check_distance(camera, where)
    return camera


def _lens_row(camera: Camera) -> dict[str, object]:
    if camera.lens is None:
        return {}
    return {
        "distortion": np.asarray(camera.lens.coefficients, float).tolist(),
        "distortion_model": camera.lens.model,
    }


def _numbers(value: object, name: str, shape: tuple[int, ...], where: str) -> np.ndarray:
    try:
        numbers = np.asarray(value, float)
    except (TypeError, ValueError, OverflowError):
        raise InputError(f"{where}: '{name}' is not an array of numbers; write numbers.") from None
    if name == "focal" and numbers.shape == ():
        numbers = np.tile(numbers, 2)
    if numbers.shape != shape:
        wanted = " x ".join(map(str, shape))
        raise InputError(f"{where}: '{name}' has the shape {numbers.shape}; expected {wanted}.")
    if not (np.abs(numbers) <= MAX_NUMBER).all():
        raise InputError(
            f"{where}: '{name}' contains a number that is not finite or too large; write finite numbers."
        )
    return numbers
