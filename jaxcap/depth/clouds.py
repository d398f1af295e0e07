"""Clouds of the person in depth images, with these images."""

from collections.abc import Callable, Sequence

import numpy as np
from jaxtyping import Bool, Float

from ..arguments import checked
from ..errors import InputError, NoPersonError, user_message
from ..geometry.camera import Camera
from ..observe.clouds import Cloud, make_cloud, missing_cloud
from ..observe.depth_views import DepthView
from .back_projection import measured_points
from .background import Background
from .check_depths import check_depth_scale, check_image_size_of, keep_measured
from .fuse import fuse_cloud
from .person import PersonSearch, check_found, check_measured, search_person
from .views import blank_view, make_depth_view

#: side of the cubes that keep one point each, metres
VOXEL = 0.012
#: largest difference in depth of neighbouring pixels on one surface, metres
GAP = 0.03
#: largest distance of the people that two cameras see in one frame, metres
MAX_APART = 1.5
#: fewest points of a person
MIN_POINTS = 50


@checked
def cloud_of_depths(
    cameras: Sequence[Camera],
    depths: Sequence[Float[np.ndarray, "H W"]],
    masks: Sequence[Bool[np.ndarray, "H W"] | None] | None = None,
    *,
    backgrounds: Sequence[Background | None] | None = None,
    voxel: float = VOXEL,
    name: str = "the frame",
    keep_missing: bool = False,
    max_apart: float = MAX_APART,
    on_search: Callable[[PersonSearch], None] | None = None,
) -> Cloud:
    """Make the cloud of the person in one frame of depth images, with their views.

    A fit of a body to this cloud also keeps the body out of the space that the cameras saw empty. A camera that sees no
    person adds nothing.

    **Arguments:** `depths`, metres, zero where nothing was measured, one for each of the `cameras`; `masks`, the pixels
    of the person, found by `find_person` where None; `backgrounds` for this search, of `estimate_background`; `voxel`, the
    side of the cubes that keep one point each, metres; `name` for messages; `keep_missing`, return a cloud without points
    instead of a `NoPersonError`: its `missing` has the reason, and tracking keeps the pose; `max_apart`, the largest
    distance of the people that two cameras see, metres: infinite for masks of several people; `on_search` is called with each search for the
    person.

    **Raises:** `InputError` if there are other numbers of images than of cameras, or an image has another size than its
    camera's, or depths that cannot be in metres; `NoPersonError` if no camera sees a person, or cameras see people that
    are too far apart to be one.
    """
    for what, number in (("masks", masks), ("backgrounds", backgrounds), ("cameras", cameras)):
        if number is not None and len(number) != len(depths):
            raise InputError(
                f"{name}: there are {len(depths)} depth images of {len(number)} {what}; expected one of each."
            )
    depths = [keep_measured(depth) for depth in depths]
    nothing = [None] * len(depths)
    masks = nothing if masks is None else masks
    backgrounds = nothing if backgrounds is None else backgrounds
    views: list[DepthView] = []
    people, reasons = [], []
    for number, (camera, depth) in enumerate(zip(cameras, depths, strict=True)):
        where = name if len(cameras) == 1 else f"{name}, camera {number}"
        try:
            person = _person(camera, depth, masks[number], backgrounds[number], where, on_search)
            views.append(make_depth_view(camera, depth, person, where))
            people.append(np.where(person, depth, 0.0))
        except NoPersonError as error:
            reasons.append(user_message(error))
            views.append(blank_view(camera))
            people.append(np.zeros(depth.shape))
    try:
        if len(reasons) == len(cameras):
            raise NoPersonError(reasons[0])
        _check_one_person(cameras, people, name, max_apart)
        scan = fuse_cloud(cameras, people, GAP, 2, voxel)
        # without a normal a point is at an edge, and may be between front and back
        sure = np.any(scan.normals != 0, 1)
        if np.count_nonzero(sure) < MIN_POINTS:
            raise NoPersonError(
                f"{name}: the person has {np.count_nonzero(sure)} points; expected at least {MIN_POINTS}."
            )
    except NoPersonError as error:
        if keep_missing:
            return missing_cloud(user_message(error), tuple(blank_view(camera) for camera in cameras))
        raise
    cloud = make_cloud(scan.points[sure], scan.normals[sure], name=name)
    return Cloud(cloud.points, cloud.normals, cloud.weights, tuple(views))


def _person(
    camera: Camera,
    depth: Float[np.ndarray, "H W"],
    mask: Bool[np.ndarray, "H W"] | None,
    background: Background | None,
    where: str,
    on_search: Callable[[PersonSearch], None] | None,
) -> Bool[np.ndarray, "H W"]:
    """Find the person, or check the mask of it. Raises as `cloud_of_depths` does."""
    if mask is None:
        check_measured(camera, depth, where)
        search = search_person(camera, depth, background, where)
        if on_search is not None:
            on_search(search)
        return check_found(search, where, takes_masks=True).person
    check_image_size_of(camera, depth, "image", where)
    check_image_size_of(camera, mask, "mask", where)
    check_depth_scale(depth, where)
    if not (mask & (depth > 0)).any():
        raise NoPersonError(
            f"{where}: the mask has no pixel with a depth; pixels of the person must not be zero in the mask. Correct the "
            "mask, or give no masks, so that the person is searched for."
        )
    return mask


def _check_one_person(
    cameras: Sequence[Camera], people: list[np.ndarray], name: str, max_apart: float
) -> None:
    """Check that the cameras see people at one position. Raises `NoPersonError`."""
    middles = {
        number: np.median(measured_points(camera, depth), axis=0)
        for number, (camera, depth) in enumerate(zip(cameras, people, strict=True))
        if (depth > 0).any()
    }
    first = min(middles)
    for number, middle in middles.items():
        apart = float(np.linalg.norm(middle - middles[first]))
        if apart > max_apart:
            raise NoPersonError(
                f"{name}: the people that cameras {first} and {number} see are {apart:.1f} m apart; check the positions "
                "and directions of the cameras, or give masks of one person."
            )
