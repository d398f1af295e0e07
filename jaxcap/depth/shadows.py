"""Shadows of the sensor: background next to a person that has no depth."""

import numpy as np
from jaxtyping import Bool, Float

#: largest distance between the two eyes of a sensor, or between its camera and its projector, metres
MAX_BASELINE = 0.08


def fill_shadows(
    depth: Float[np.ndarray, "H W"], person: Bool[np.ndarray, "H W"], focal: float
) -> Float[np.ndarray, "H W"]:
    """Give background that is hidden from one eye of the sensor the depth of the background next to it.

    Sensors with a projector or with two eyes see a surface from two points on a horizontal line. Next to a
    person, a strip of the background is hidden from one of these, and has no depth, although the image shows
    it. The strip is at most as wide as the difference of both surfaces' disparities.

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
