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
from .check_depths import check_image_size_of, keep_measured


@checked
def find_floor_of_person(
    cameras: Sequence[Camera],
    depths: Sequence[Float[np.ndarray, "H W"]],
    cloud: Cloud,
    up: tuple[float, float, float] = (0.0, 1.0, 0.0),
) -> Plane | None:
    """Find the floor below a person in the depth images of one frame; None if no camera shows it.

    `make_floor(body, plane.offset, tuple(plane.normal))` is the energy of such a plane.

    **Arguments:** `depths`, metres, zero where nothing was measured, one for each of the `cameras`; `cloud` of the person;
    `up`, the vertical.

    **Raises:** `InputError` if an image has another size than its camera's.
    """
    person = np.asarray(cloud.points, float)[np.asarray(cloud.weights) > 0]
    for camera, image in zip(cameras, depths, strict=True):
        check_image_size_of(camera, image, "image", "find_floor_of_person")
        depth = keep_measured(image)
        step = search_step(depth.shape)
        points = world_points(camera, depth, step)[depth[::step, ::step] > 0]
        level = find_floor(find_planes(points, np.asarray(camera.eye, float)), up)
        floor = None if level is None else refine_plane(level, points)
        if floor is not None and len(person) and is_floor_of(floor, points, person):
            return floor
    return None
