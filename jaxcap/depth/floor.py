"""The floor on which a person is, in the depth images of one frame."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from ..arguments import checked
from ..geometry.camera import Camera
from ..observe.clouds import Cloud
from ..observe.floor import find_floor, is_floor_of
from ..observe.planes import Plane, find_planes, refine_plane
from .back_projection import world_points
from .candidates import search_step


@checked
def find_floor_of_person(
    cameras: Sequence[Camera], depths: Sequence[Float[np.ndarray, "H W"]], cloud: Cloud
) -> Plane | None:
    """Find the floor below a person in the depth images of one frame, y up; None if no camera shows it.

    `make_floor(body, plane.offset, tuple(plane.normal))` is the energy of such a plane.

    **Arguments:** `depths`, metres, zero where nothing was measured, one for each of the `cameras`; `cloud` of the person.
    """
    person = np.asarray(cloud.points, float)[np.asarray(cloud.weights) > 0]
    for camera, depth in zip(cameras, depths, strict=True):
        points = world_points(camera, depth, search_step(depth.shape))
        points = points[np.any(points != 0, axis=-1)]
        floor = find_floor(find_planes(points, np.asarray(camera.eye, float)))
        if floor is not None and len(person) and is_floor_of(refine_plane(floor, points), person):
            return refine_plane(floor, points)
    return None
