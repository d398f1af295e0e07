"""The floor among the planes of a room, and whether it is the floor on which a person is."""

import numpy as np
from jaxtyping import Float

from ..arguments import checked
from .planes import PLANE_DISTANCE, Plane, on_planes

#: largest angle between the normal of a floor and the vertical, degrees
MAX_FLOOR_TILT = 35.0
#: share of a person's points that may be lower or higher than the others by error
OUTLIER_SHARE = 0.01
#: largest distance of the lowest points from the floor, metres: feet may be hidden or in the air
MAX_FOOT_HEIGHT = 0.4
#: least height of the highest point above the floor, metres: above that of a person behind a table, over the table
MIN_TOP_HEIGHT = 1.2
#: height of the points above the lowest one whose mean is the foot, and the distances from it in which the floor is looked for, metres
FOOT_HEIGHT, NEAR, FAR = 0.1, 0.2, 1.0
#: number of directions around the foot, and least number of those in which the floor is seen: more than the half in front of
#: a person behind a bed
NUM_DIRECTIONS, MIN_DIRECTIONS = 12, 9


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
def is_floor_of(plane: Plane, points: Float[np.ndarray, "N 3"], person: Float[np.ndarray, "M 3"]) -> bool:
    """Test if a plane is the floor on which a person is, from all measured `points` and those of the person, metres.

    The lowest points of the person are near a floor, the highest ones far above it, and the floor is seen around the feet. A table,
    a bed or a sofa in front of a person is a level plane too, but only on one side of the person. So a person whose feet are
    hidden, or who sits low or lies, has no floor.
    """
    heights = person @ plane.normal - plane.offset
    low, high = np.quantile(heights, [OUTLIER_SHARE, 1 - OUTLIER_SHARE])
    if not (-2 * PLANE_DISTANCE < low < MAX_FOOT_HEIGHT and high > MIN_TOP_HEIGHT):
        return False
    foot = person[heights <= low + FOOT_HEIGHT].mean(0)
    across = np.linalg.svd(plane.normal[None])[2][1:]
    away = (points[on_planes([plane], points)] - foot) @ across.T
    distances = np.linalg.norm(away, axis=1)
    away = away[(distances > NEAR) & (distances < FAR)]
    directions = np.floor(np.arctan2(away[:, 1], away[:, 0]) / (2 * np.pi) * NUM_DIRECTIONS)
    return len(np.unique(directions)) >= MIN_DIRECTIONS
