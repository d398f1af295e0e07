"""Clouds of the person in depth images, with these images."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float

from ..arguments import checked
from ..errors import InputError
from ..geometry.camera import Camera
from ..observe.clouds import Cloud, make_cloud
from .fuse import fuse_cloud
from .person import find_person
from .views import make_depth_view

#: side of the cubes that keep one point each, metres
VOXEL = 0.012
#: largest difference in depth of neighbouring pixels on one surface, metres
GAP = 0.03


@checked
def cloud_of_depths(
    cameras: Sequence[Camera],
    depths: Sequence[Float[np.ndarray, "H W"]],
    masks: Sequence[Bool[np.ndarray, "H W"] | None] | None = None,
    *,
    voxel: float = VOXEL,
    name: str = "the frame",
) -> Cloud:
    """Make the cloud of the person in one frame of depth images, with their views.

    A fit of a body to this cloud also keeps the body out of the space that the cameras saw empty.

    **Arguments:** `depths`, metres, zero where nothing was measured, one for each of the `cameras`; `masks`, the pixels
    of the person, found by `find_person` where None; `voxel`, the side of the cubes that keep one point each, metres;
    `name` for messages.

    **Raises:** `InputError` if there are other numbers of images than of cameras, an image has another size than its
    camera's, or shows no person.
    """
    if not len(cameras) == len(depths) == len(depths if masks is None else masks):
        raise InputError(
            f"{name}: there are {len(depths)} depth images of {len(cameras)} cameras; expected one of each."
        )
    people, views = [], []
    for number, (camera, depth) in enumerate(zip(cameras, depths, strict=True)):
        where = name if len(cameras) == 1 else f"{name}, camera {number}"
        known = None if masks is None else masks[number]
        person = find_person(camera, depth, where) if known is None else known
        views.append(make_depth_view(camera, depth, person, where))
        people.append(np.where(person, depth, 0.0))
    scan = fuse_cloud(cameras, people, GAP, 2, voxel)
    # without a normal a point is at an edge, and may be between front and back
    sure = np.any(scan.normals != 0, 1)
    cloud = make_cloud(scan.points[sure], scan.normals[sure], name=name)
    return Cloud(cloud.points, cloud.normals, cloud.weights, tuple(views))
