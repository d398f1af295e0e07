"""Depth images of one camera, with the pixels that belong to the person."""

import equinox as eqx
import numpy as np
from jaxtyping import Array, Bool, Float
from scipy.ndimage import distance_transform_edt

from ..arguments import as_jax_array, check_fields, checked
from ..errors import InputError
from ..geometry.camera import Camera

#: longest side of the images of a view, pixels: larger images are reduced
MAX_VIEW_SIDE = 320
#: largest distance between the two eyes of a sensor, or between its camera and its projector, metres
MAX_BASELINE = 0.08


class DepthView(eqx.Module):
    """A depth image of one frame, divided into the person and measured background.

    Images are `(height, width)` of the camera.
    """

    camera: Camera
    #: depth of the measured surface along the optical axis, metres; zero where nothing was measured
    depth: Float[Array, "*frames H W"] = eqx.field(converter=as_jax_array)
    #: distance to the person's nearest pixel where background was measured, pixels; zero elsewhere
    outside: Float[Array, "*frames H W"] = eqx.field(converter=as_jax_array)

    def __check_init__(self):
        check_fields(self)


@checked
def make_depth_view(
    camera: Camera, depth: Float[np.ndarray, "H W"], person: Bool[np.ndarray, "H W"], where: str = "the image"
) -> DepthView:
    """Make a view from a depth image and the mask of the person.

    Background in the shadow of the person is filled (`fill_shadows`). Images with more than `MAX_VIEW_SIDE` pixels on a side are reduced: a reduced pixel belongs to the person if any
    of its pixels does, and has the smallest depth of these.

    **Arguments:** `depth`, metres, zero where nothing was measured; `where` names the image in messages.

    **Raises:** `InputError` if the images are not of the camera's size, or no pixel of the person was measured.
    """
    check_image_size_of(camera, depth, "image", where)
    check_image_size_of(camera, person, "mask", where)
    measured = np.isfinite(depth) & (depth > 0)
    if not (person & measured).any():
        raise InputError(
            f"{where}: no pixel of the person was measured; give another mask, or leave out the frame."
        )
    depth = fill_shadows(np.where(measured, depth, 0.0), person, float(camera.focal[0]))
    measured = depth > 0
    step = -(-max(depth.shape) // MAX_VIEW_SIDE)
    person, background = person & measured, ~person & measured
    person_depth = _reduce(np.where(person, depth, np.inf), step)
    background_depth = _reduce(np.where(background, depth, np.inf), step)
    shown = np.isfinite(person_depth)
    empty = ~shown & np.isfinite(background_depth)
    depth = np.where(shown, person_depth, np.where(empty, background_depth, 0.0))
    outside = np.where(empty, np.asarray(distance_transform_edt(~shown)), 0.0)
    return DepthView(reduce_camera(camera, step), depth.astype(np.float32), outside.astype(np.float32))  # pyright: ignore[reportArgumentType]


def fill_shadows(
    depth: Float[np.ndarray, "H W"], person: Bool[np.ndarray, "H W"], focal: float
) -> Float[np.ndarray, "H W"]:
    """Give background that is hidden from one eye of the sensor the depth of the background next to it.

    Sensors with a projector or with two eyes see a surface from two points on a horizontal line. Next to a person, a strip
    of the background is hidden from one of these, and has no depth, although the image shows it. The strip is at most as
    wide as the difference of both surfaces' disparities.

    **Arguments:** `depth`, metres, zero where nothing was measured; `focal`, pixels.
    """
    width, measured = depth.shape[1], depth > 0
    columns = np.broadcast_to(np.arange(width), depth.shape)
    # the nearest measured columns on both sides
    left = np.maximum.accumulate(np.where(measured, columns, -1), axis=1)
    right = np.minimum.accumulate(np.where(measured, columns, width)[:, ::-1], axis=1)[:, ::-1]
    row, column = np.nonzero(~measured & (left >= 0) & (right < width))
    left, right = left[row, column], right[row, column]
    on_left = person[row, left]
    near = depth[row, np.where(on_left, left, right)]
    far = depth[row, np.where(on_left, right, left)]
    widest = focal * MAX_BASELINE * (1.0 / near - 1.0 / far) + 1.0
    in_shadow = (on_left != person[row, right]) & (far > near) & (right - left - 1 <= widest)
    filled = depth.copy()
    filled[row[in_shadow], column[in_shadow]] = far[in_shadow]
    return filled


def check_image_size_of(camera: Camera, image: np.ndarray, name: str, where: str) -> None:
    """Check that an image has the size of its camera's images. Raises `InputError`."""
    if image.shape != (camera.height, camera.width):
        raise InputError(
            f"{where}: the {name} has {image.shape[1]} x {image.shape[0]} pixels; expected {camera.width} x "
            f"{camera.height}, as the camera."
        )


def _reduce(image: Float[np.ndarray, "H W"], step: int) -> Float[np.ndarray, "h w"]:
    """Take the least value of each block of `step` rows and columns."""
    height, width = (-(-side // step) for side in image.shape)
    padded = np.full((height * step, width * step), np.inf)
    padded[: image.shape[0], : image.shape[1]] = image
    return padded.reshape(height, step, width, step).min((1, 3))


def reduce_camera(camera: Camera, step: int) -> Camera:
    """Return the camera of images with blocks of `step` rows and columns as pixels."""
    if step == 1:
        return camera
    # the centre of a block of pixels is (step - 1) / 2 after its first pixel
    middle = (camera.principal_point - (step - 1) / 2) / step
    return Camera(
        camera.rotation,
        camera.translation,
        camera.focal / step,
        middle,
        -(-camera.width // step),
        -(-camera.height // step),
    )
