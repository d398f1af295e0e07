"""Views of a person made from depth images."""

import numpy as np
from jaxtyping import Bool, Float
from scipy.ndimage import distance_transform_edt

from ..arguments import checked
from ..errors import NoPersonError
from ..geometry.camera import Camera
from ..observe import DepthView
from .check_depths import check_image_size_of, keep_measured
from .shadows import fill_shadows

#: longest side of the images of a view, pixels: larger images are reduced
MAX_VIEW_SIDE = 320
#: number of rows and columns around a pixel whose nearest depth it takes: at edges, pixels mix depths, and a finger is as
#: narrow as a pixel
EDGE_WINDOW = 3
#: number of levels of depth; share of the person's pixels nearer than the first level; and number of pixels around the
#: person with distances of their own for each level
NUM_LEVELS, NEAREST_LEVEL, LEVEL_MARGIN = 6, 0.01, 24


@checked
def make_depth_view(
    camera: Camera, depth: Float[np.ndarray, "H W"], person: Bool[np.ndarray, "H W"], where: str = "the image"
) -> DepthView:
    """Make a view from a depth image and the mask of the person.

    Background in the shadow of the person is filled (`fill_shadows`). Images with more than `MAX_VIEW_SIDE`
    pixels on a side are reduced: a reduced pixel belongs to the person if any of its pixels does, and has the
    smallest depth of these. A pixel of the person has the smallest depth of the person's pixels next to it.

    **Arguments:** `depth`, metres, zero where nothing was measured; `where` names the image in messages.

    **Raises:** `InputError` if the images are not of the camera's size; `NoPersonError` if no pixel of the person was
    measured.
    """
    check_image_size_of(camera, depth, "image", where)
    check_image_size_of(camera, person, "mask", where)
    depth = keep_measured(depth)
    if not (person & (depth > 0)).any():
        raise NoPersonError(
            f"{where}: no pixel of the person was measured; give another mask, or leave out the frame."
        )
    depth = fill_shadows(depth, person, float(camera.focal[0]))
    step = view_step(*depth.shape)
    images = view_images(depth, person, step)
    return DepthView(reduce_camera(camera, step), *images)  # pyright: ignore[reportArgumentType]


def view_images(
    depth: Float[np.ndarray, "H W"], person: Bool[np.ndarray, "H W"], step: int
) -> tuple[Float[np.ndarray, "h w"], Float[np.ndarray, "L"], Float[np.ndarray, "L h w"]]:
    """Compute the images of a view, reduced by `step`: depths; levels of depth; and distances of each, pixels."""
    measured = depth > 0
    person, background = person & measured, ~person & measured
    in_front = np.where(person, depth, np.inf)
    person_depth = _reduce(in_front, step)
    nearest = _minimum_around(in_front)
    background_depth = _reduce(np.where(background, depth, np.inf), step)
    shown = np.isfinite(person_depth)
    empty = ~shown & np.isfinite(background_depth)
    reduced = np.where(shown, _reduce(nearest, step), np.where(empty, background_depth, 0.0))
    levels, distances = _level_distances(np.where(shown, reduced, np.inf))
    return reduced.astype(np.float32), levels.astype(np.float32), distances.astype(np.float32)


def _level_distances(
    person: Float[np.ndarray, "h w"],
) -> tuple[Float[np.ndarray, "L"], Float[np.ndarray, "L h w"]]:
    """Compute levels of depth, and the distance of each pixel to the person's nearest pixel not farther than each level.

    More than `LEVEL_MARGIN` pixels outside of the box around the person, the distances of the last level stand for all.
    """
    shown = np.isfinite(person)
    if not shown.any():
        return np.zeros(NUM_LEVELS), np.zeros((NUM_LEVELS, *person.shape))
    near, far = np.quantile(person[shown], NEAREST_LEVEL), person[shown].max()
    levels = np.linspace(near, far, NUM_LEVELS)
    distances = np.repeat(np.asarray(distance_transform_edt(~shown))[None], NUM_LEVELS, axis=0)
    sides = (np.flatnonzero(shown.any(axis)) for axis in (1, 0))
    box = tuple(slice(max(side[0] - LEVEL_MARGIN, 0), side[-1] + LEVEL_MARGIN + 1) for side in sides)
    for level, image in zip(levels[:-1], distances[:-1], strict=True):
        image[box] = distance_transform_edt(person[box] > level)
    return levels, distances


def blank_view(camera: Camera) -> DepthView:
    """Make the view of a camera that sees no person in a frame: it measures nothing."""
    camera = reduce_camera(camera, view_step(camera.height, camera.width))
    levels, image = np.zeros(NUM_LEVELS, np.float32), np.zeros((camera.height, camera.width), np.float32)
    return DepthView(camera, image, levels, np.zeros((NUM_LEVELS, *image.shape), np.float32))  # pyright: ignore[reportArgumentType]


def view_step(height: int, width: int) -> int:
    """Return the number of rows and columns that one pixel of a view has."""
    return -(-max(height, width) // MAX_VIEW_SIDE)


def _minimum_around(image: Float[np.ndarray, "H W"]) -> Float[np.ndarray, "H W"]:
    """Take the least value of the `EDGE_WINDOW` rows and columns around each pixel; slices are faster than a filter."""
    reach, (height, width) = EDGE_WINDOW // 2, image.shape
    padded = np.pad(image, reach, constant_values=np.inf)
    rows = np.minimum.reduce([padded[k : k + height] for k in range(EDGE_WINDOW)])
    return np.minimum.reduce([rows[:, k : k + width] for k in range(EDGE_WINDOW)])


def _reduce(image: Float[np.ndarray, "H W"], step: int) -> Float[np.ndarray, "h w"]:
    """Take the least value of each block of `step` rows and columns."""
    height, width = (-(-side // step) for side in image.shape)
    padded = np.full((height * step, width * step), np.inf, image.dtype)
    padded[: image.shape[0], : image.shape[1]] = image
    # slices are several times faster than a minimum over two axes of four
    rows = np.minimum.reduce([padded[k::step] for k in range(step)])
    return np.minimum.reduce([rows[:, k::step] for k in range(step)])


def take_pixels(camera: Camera, step: int) -> Camera:
    """Return the camera of images with every `step`-th row and column of this one's, from the first."""
    return _with_larger_pixels(camera, step, 0.0)


def reduce_camera(camera: Camera, step: int) -> Camera:
    """Return the camera of images with blocks of `step` rows and columns as pixels."""
    # the centre of a block of pixels is (step - 1) / 2 after its first pixel
    return _with_larger_pixels(camera, step, (step - 1) / 2)


def _with_larger_pixels(camera: Camera, step: int, first: float) -> Camera:
    """Return the camera of images with a pixel for `step` rows and columns, the first one centred on row and column `first`."""
    if step == 1:
        return camera
    return Camera(
        camera.rotation,
        camera.translation,
        camera.focal / step,
        (camera.principal_point - first) / step,
        -(-camera.width // step),
        -(-camera.height // step),
    )
