"""Single images: depths and masks as PNG or TIFF, by Pillow."""

from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float

from ...arguments import checked
from ...depth.check_depths import keep_measured
from ...errors import InputError
from ...geometry.camera import MAX_PIXELS
from ..system.atomic import atomic_path
from ..system.reader_errors import reader_of

SUFFIXES = (".png", ".tif", ".tiff")
#: names of the array of depth images in an `.npz`
DEPTH_ARRAYS = ("depth", "depth_mm", "depths")


def is_depth_image(path: str | Path) -> bool:
    """Test by its header if an image has one channel of more than eight bits."""
    if Path(path).suffix.lower() not in SUFFIXES:
        return False
    from PIL import Image

    try:
        with Image.open(path) as image:
            return image.mode.startswith(("I", "F"))
    except (OSError, SyntaxError, Image.DecompressionBombError):
        return False


@reader_of("a depth image")
def read_depth_image(path: str | Path, depth_scale: float = 1000.0) -> Float[np.ndarray, "H W"]:
    """Read a depth image, metres; zero for pixels without measurement.

    **Arguments:** `depth_scale`, the number of the file's units in a metre, for whole numbers; images of floating
    point numbers are in metres.

    **Raises:** `InputError` if the file is no image, or has colours or eight bits, which cannot be depths.
    """
    image = _read(path)
    if image.ndim != 2 or image.dtype in (np.uint8, np.bool_):
        found = (
            f"{image.shape[2]} channels, so it is a picture"
            if image.ndim > 2
            else "8 bits: 256 numbers are too few for depths, so it is a picture"
        )
        raise InputError(
            f"{path}: the image has {found} and no depth image; expected one channel of 16 bits. Give the 16-bit images of "
            "the depth camera."
        )
    return depths_in_metres(image, depth_scale)


def depths_in_metres(image: np.ndarray, depth_scale: float) -> Float[np.ndarray, "*F H W"]:
    """Convert depths to metres: whole numbers by their scale; zero where they are not finite or not above zero."""
    return keep_measured(image / depth_scale if image.dtype.kind in "iu" else image.astype(float))


@reader_of("a mask")
def read_mask(path: str | Path) -> Bool[np.ndarray, "H W"]:
    """Read a mask: true where any channel but transparency is not zero.

    **Raises:** `InputError` if the file is no image.
    """
    image = _read(path)
    return (image if image.ndim == 2 else image[..., :3].max(-1)) > 0


@checked
def write_depth_image(
    path: str | Path, depth: Float[np.ndarray, "H W"], depth_scale: float | int = 1000.0
) -> None:
    """Write a depth image, metres, as a PNG of 16 bits in units of `1 / depth_scale` metres.

    Pixels that are not measured are zero. So are depths above the largest number of 16 bits, 65 m in millimetres.

    **Raises:** `InputError` if the file cannot be written.
    """
    units = np.round(np.where(np.isfinite(depth), depth, 0.0) * depth_scale)
    _write(path, np.where((units > 0) & (units < 2**16), units, 0).astype(np.uint16))


@checked
def write_mask(path: str | Path, mask: Bool[np.ndarray, "H W"]) -> None:
    """Write a mask as a PNG, white where it is true. Raises `InputError` if the file cannot be written."""
    _write(path, np.where(mask, 255, 0).astype(np.uint8))


def damaged_image(path: str | Path, error: Exception) -> InputError:
    """Make the error of an image that a library cannot read."""
    return InputError(
        f"{path}: the image cannot be read: {str(error).rstrip('.')}. It may be incomplete or damaged: copy it again, or leave "
        "out the frame."
    )


def _write(path: str | Path, image: np.ndarray) -> None:
    from PIL import Image

    with atomic_path(path) as temporary:
        Image.fromarray(image).save(temporary, format="PNG")


def _read(path: str | Path) -> np.ndarray:
    from PIL import Image, UnidentifiedImageError

    if Path(path).suffix.lower() not in SUFFIXES:
        raise InputError(f"{path}: this is no depth image; expected {', '.join(SUFFIXES)}.")
    if not Path(path).is_file():
        raise InputError(f"{path}: there is no such file; check the path.")
    try:
        with Image.open(path) as image:
            if image.width * image.height > MAX_PIXELS:
                raise InputError(
                    f"{path}: the image has {image.width} x {image.height} pixels; expected at most {MAX_PIXELS}."
                )
            return np.array(image)
    except (UnidentifiedImageError, OSError, SyntaxError, Image.DecompressionBombError) as error:
        raise damaged_image(path, error) from None
