"""The person in a depth image near the place where the previous image shows it."""

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial import KDTree

from ..candidates import connect_pixels, search_step
from ..person import enlarge_mask
from .fixed_camera import FixedCamera, ImageBox

#: farthest that the surface of the person may move from its last place, metres: a hand at 7 m/s in a thirtieth of a second
MARGIN = 0.25
#: pixels nearer than this to the last surface belong to the person, metres
NEAR = 0.12
#: least share of a connected surface that has to be near the last surface
MIN_NEAR_SHARE = 0.3
#: least number of pixels of a surface in the search
MIN_PIXELS = 4
#: least share of the last surface's points that have to be found again
MIN_FOUND_SHARE = 0.25
#: number of points of the last surface that pixels are compared with
NUM_POINTS = 800


def follow_person(
    fixed: FixedCamera, depth: Float[np.ndarray, "H W"], surface: Float[np.ndarray, "N 3"]
) -> tuple[ImageBox, Bool[np.ndarray, "h w"]] | None:
    """Find the pixels of the person near its last surface; None if too little of it is found.

    Connected surfaces without floor, walls and background belong to the person if they are near the last `surface`, points of the posed
    body in the world. The mask is that of the returned box.
    """
    step = search_step(depth.shape)
    box = fixed.box_around(surface, MARGIN, 2 * step)
    if box is None:
        return None
    here = depth[box.rows, box.columns]
    small = here[::step, ::step]
    small = np.where(
        (small > box.nearest) & (small < box.farthest) & ~fixed.on_room(small, box, step), small, 0.0
    )
    labels = connect_pixels(small, small > 0)
    points = fixed.points(small, box, step)
    tree = KDTree(surface[:: max(1, len(surface) // NUM_POINTS)])
    near = np.isfinite(tree.query(points, distance_upper_bound=NEAR)[0])
    of = labels[small > 0]
    count = int(labels.max()) + 1
    pixels, close = np.bincount(of, minlength=count), np.bincount(of, near, count)
    kept = (pixels >= MIN_PIXELS) & (close >= MIN_NEAR_SHARE * pixels)
    kept[0] = False
    seen = _expected_pixels(fixed, box, surface, step)
    if not kept.any() or close[kept].sum() < MIN_FOUND_SHARE * seen:
        return None
    return box, _enlarge(fixed, box, here, kept[labels], small, step)


def _enlarge(
    fixed: FixedCamera,
    box: ImageBox,
    depth: Float[np.ndarray, "h w"],
    small: Bool[np.ndarray, "a b"],
    small_depth: Float[np.ndarray, "a b"],
    step: int,
) -> Bool[np.ndarray, "h w"]:
    """Enlarge a mask of every `step`-th pixel to all pixels, within the rows and columns around it only."""
    rows, columns = (
        slice(max(int(some[0]) - 1, 0), int(some[-1]) + 2)
        for some in (np.flatnonzero(small.any(axis)) for axis in (1, 0))
    )
    inner = tuple(slice(side.start * step, side.stop * step) for side in (rows, columns))
    across = [
        slice(whole.start + part.start, min(whole.start + part.stop, whole.stop))
        for whole, part in zip((box.rows, box.columns), inner, strict=True)
    ]
    there = ImageBox(across[0], across[1], box.nearest, box.farthest)
    here = depth[inner]
    free = (here > box.nearest) & (here > 0) & (here < box.farthest) & ~fixed.on_room(here, there)
    person = np.zeros(depth.shape, bool)
    person[inner] = enlarge_mask(small[rows, columns], small_depth[rows, columns], here, free, step)
    return person


def _expected_pixels(fixed: FixedCamera, box: ImageBox, surface: Float[np.ndarray, "N 3"], step: int) -> int:
    """Count the pixels of the search that the last surface covers."""
    there = surface @ fixed.rotation.T + fixed.translation
    there = there[there[:, 2] > MARGIN]
    pixels = (
        fixed.focal * there[:, :2] / there[:, 2:] + fixed.middle - [box.columns.start, box.rows.start]
    ) / step
    column, row = np.round(pixels).astype(int).T
    height, width = ((side.stop - side.start) // step for side in (box.rows, box.columns))
    inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
    return len(np.unique(row[inside] * width + column[inside]))
