"""Depth images in OpenEXR files (.exr), as Blender and other renderers write them, by the library OpenEXR."""

from pathlib import Path

import numpy as np
from jaxtyping import Float

from ...errors import InputError
from ...geometry.camera import MAX_PIXELS
from ..system.reader_errors import reader_of
from .images import damaged_image, depths_in_metres

EXR_SUFFIX = ".exr"
#: depths beyond it are what renderers write where they see nothing, metres
MAX_DEPTH = 1e3
#: names of the channel of depths, in the order in which they are looked for; a layer's name may stand before them
DEPTH_CHANNELS = ("Z", "depth", "V", "Y", "R")


@reader_of("a depth image")
def read_exr_depth(path: str | Path) -> Float[np.ndarray, "H W"]:
    """Read depths, metres along the optical axis; zero beyond 1 km, where renderers see nothing.

    They are in the channel `Z`, as in Blender's Depth pass, or `depth`, `V`, `Y`, or `R` if there is no other than it, or
    if all colours are the same.

    **Raises:** `InputError` if the library is not installed, or the file has no such channel.
    """
    try:
        import OpenEXR
    except ImportError:
        raise InputError(
            f"{path}: reading .exr needs the library OpenEXR, which is not installed; run pip install -e '.[recordings]' in "
            "a checkout of jaxcap."
        ) from None
    if not Path(path).is_file():
        raise InputError(f"{path}: there is no such file; check the path.")
    try:
        with OpenEXR.File(str(path), separate_channels=True) as file:
            parts = [file.channels(number) for number in range(len(file.parts))]
            channels = {name: np.asarray(one.pixels) for part in parts for name, one in part.items()}
    except Exception as error:  # a parser of another library: whatever it raises is a fault of the file
        raise damaged_image(path, error) from None
    depth = _depth_channel(channels)
    if depth is None or depth.ndim != 2 or depth.dtype.kind != "f":
        raise InputError(
            f"{path}: the image has the channels {', '.join(channels)}; expected one of depths, named Z as in Blender's Depth "
            "pass."
        )
    if depth.size > MAX_PIXELS:
        raise InputError(
            f"{path}: the image has {depth.shape[1]} x {depth.shape[0]} pixels; expected at most {MAX_PIXELS}."
        )
    metres = depths_in_metres(depth.astype(float), 1.0)
    return np.where(metres < MAX_DEPTH, metres, 0.0)


def _depth_channel(channels: dict[str, np.ndarray]) -> np.ndarray | None:
    by_name = {name.rsplit(".", 1)[-1]: pixels for name, pixels in channels.items()}
    found = next((by_name[name] for name in DEPTH_CHANNELS if name in by_name), None)
    colours = [by_name[name] for name in "RGB" if name in by_name]
    if found is not None and len(colours) == 3 and found is colours[0]:
        return found if all(np.array_equal(found, one, equal_nan=True) for one in colours[1:]) else None
    return found
