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


def check_depth_scale(depth: Float[np.ndarray, "*frames H W"], where: str) -> None:
    """Check that the median depth of one or more images is one that depth cameras measure.

    **Raises:** `InputError` with the factor by which the scale of depths is wrong.
    """
    measured = depth[depth > 0]
    if not len(measured):
        return
    median = float(np.median(measured))
    if MIN_MEDIAN <= median <= MAX_MEDIAN:
        return
    factor = 10.0 ** round(abs(np.log10(median / USUAL_MEDIAN)))
    wrong, right = ("large", "larger") if median > MAX_MEDIAN else ("small", "smaller")
    raise InputError(
        f"{where}: the median depth is {median:.3g} m; expected {MIN_MEDIAN:g} to {MAX_MEDIAN:g} m. Depths seem to be "
        f"{factor:g} times too {wrong}; give a depth scale that is {factor:g} times {right} (units in a metre). "
        "Images of floating-point numbers have none: convert them to metres."
    )
