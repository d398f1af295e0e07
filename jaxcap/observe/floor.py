"""The floor among the planes of a room, and whether it is the floor on which a person is."""

import numpy as np
from jaxtyping import Float

from ..arguments import checked
from .planes import PLANE_DISTANCE, Plane

#: largest angle between the normal of a floor and the vertical, degrees
MAX_FLOOR_TILT = 35.0
#: share of a person's points that may be lower or higher than the others by error
OUTLIER_SHARE = 0.01
#: largest distance of the lowest points from the floor, metres: feet may be hidden or in the air
MAX_FOOT_HEIGHT = 0.4
#: least height of the highest point above the floor, metres: above that of a person behind a table, over the table
MIN_TOP_HEIGHT = 1.2


@checked
def find_floor(
    planes: list[Plane], up: tuple[float, float, float] = (0.0, 1.0, 0.0), max_tilt: float = MAX_FLOOR_TILT
) -> Plane | None:
    """Find the floor: of the planes whose normals are nearly vertical the lowest one; None if there is none.

    **Arguments:** `planes` of `find_planes`; `up`, the vertical; `max_tilt`, degrees: cameras without extrinsics may be
    tilted.
    """
    vertical = np.asarray(up, float) / np.linalg.norm(up)
    level = [plane for plane in planes if plane.normal @ vertical >= np.cos(np.radians(max_tilt))]
    # the height at which a plane intersects the vertical through the origin
    return min(level, key=lambda plane: plane.offset / (plane.normal @ vertical), default=None)


@checked
def is_floor_of(plane: Plane, points: Float[np.ndarray, "N 3"]) -> bool:
    """Test if a plane is the floor on which a person is, from points of the person.

    A table in front of a person is a level plane too, and a body must not be kept above it. So a person whose feet are hidden, or
    who sits low or lies, has no floor.
    """
    heights = points @ plane.normal - plane.offset
    low, high = np.quantile(heights, [OUTLIER_SHARE, 1 - OUTLIER_SHARE])
    return bool(-2 * PLANE_DISTANCE < low < MAX_FOOT_HEIGHT and high > MIN_TOP_HEIGHT)
