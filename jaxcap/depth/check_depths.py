"""Checks that a depth image fits its camera, that its depths can be in metres, and which of its pixels were measured."""

import numpy as np
from jaxtyping import Float

from ..errors import InputError
from ..geometry.camera import Camera, check_rectified

#: range of the median depth of an image, metres, and a usual one
MIN_MEDIAN, MAX_MEDIAN, USUAL_MEDIAN = 0.1, 30.0, 2.0
#: depths from this on are what renderers write where they see nothing, metres; millimetres by mistake are below it
NOTHING = 1e6


def check_image_size_of(camera: Camera, image: np.ndarray, name: str, where: str) -> None:
    """Check that an image has the size of its camera's images, without distortion. Raises `InputError`."""
    check_rectified(camera, where)
    check_image_size(camera, image, name, where)


def check_image_size(camera: Camera, image: np.ndarray, name: str, where: str) -> None:
    """Check that an image has the size of its camera's images, distorted or not. Raises `InputError`."""
    if image.shape != (camera.height, camera.width):
        raise InputError(
            f"{where}: the {name} has {image.shape[1]} x {image.shape[0]} pixels; expected {camera.width} x "
            f"{camera.height}, as the camera. Give images of this size, or the intrinsics for {image.shape[1]} x "
            f"{image.shape[0]} pixels."
        )


def keep_measured(depth: Float[np.ndarray, "*frames H W"]) -> Float[np.ndarray, "*frames H W"]:
    """Set depths to zero whose pixels were not measured: those not above zero, not a number, infinite or as good as that."""
    measured = (depth > 0) & (depth < NOTHING)
    return depth if measured.all() else np.where(measured, depth, 0.0)


def depth_excess(depth: Float[np.ndarray, "*frames H W"]) -> float:
    """Return the power of ten by which the depths of one or more images are too large, below 1 if they are too small.

    It is 1 if the median depth is one that depth cameras measure, and if nothing was measured.
    """
    measured = depth[depth > 0]
    median = float(np.median(measured)) if len(measured) else USUAL_MEDIAN
    return 1.0 if MIN_MEDIAN <= median <= MAX_MEDIAN else 10.0 ** round(np.log10(median / USUAL_MEDIAN))


def check_depth_scale(depth: Float[np.ndarray, "*frames H W"], where: str) -> None:
    """Check that the median depth of one or more images is one that depth cameras measure.

    **Raises:** `InputError` with the factor by which the scale of depths is wrong.
    """
    excess = depth_excess(depth)
    if excess == 1:
        return
    factor = max(excess, 1 / excess)
    wrong, right = ("large", "larger") if excess > 1 else ("small", "smaller")
    median = np.format_float_positional(np.median(depth[depth > 0]), precision=3, fractional=False, trim="-")
    raise InputError(
        f"{where}: the median depth is {median} m; expected {MIN_MEDIAN:g} to {MAX_MEDIAN:g} m. Depths seem to be "
        f"{factor:g} times too {wrong}; give a depth scale that is {factor:g} times {right} (units in a metre). "
        "Images of floating-point numbers have none: convert them to metres."
    )
