"""Early checks that scans show one person and that the given cameras took them."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from ..body.body import Body, pose_body
from ..errors import InputError
from ..fit.correspondence.find_pairs import within_aperture
from ..fit.correspondence.nearest_assignment import IndexedScan, make_scan
from ..geometry.camera import Camera, check_views
from ..geometry.closest import nearest_on_surface
from ..geometry.sampling import connected_labels
from ..observe.clouds import Cloud, make_cloud, thin_cloud
from .adapt_body import adapt_body
from .task import AdaptState, AdaptTask

#: largest distance of an explained point, as a share of the body's height, and least cosine between the
#: normals
MAX_EXPLAINED_DISTANCE, MIN_NORMAL_COSINE = 0.05, 0.8
#: least share of nearby points that the body explains if they are a person's; a body curled up in a box or
#: along a post explains fewer. The second share is for a person with a load, if the explained points extend
#: over the third share of the body's height
MIN_EXPLAINED, MIN_EXPLAINED_WITH_LOAD, MIN_EXTENT_WITH_LOAD = 0.62, 0.42, 0.85
#: least extent of a folded person, as a share of the height
MIN_FOLDED_EXTENT = 0.4
#: distance, as a share of the body's height, beyond which points belong to another object
MIN_OBJECT_DISTANCE = 0.15
#: another object may be a person if it has at least this share of the points, at least this share of the
#: body's height, and at most this width, as a share of the same height
MIN_OBJECT_SHARE, MIN_OBJECT_HEIGHT, MAX_OBJECT_WIDTH = 0.15, 0.5, 1.3
#: number of points of a later scan that is checked for a second person, and number of objects in these scans that are compared
#: with a person
NUM_CHECKED, MAX_OBJECTS = 5000, 5
#: share of a scan's points that may lie below its floor
FLOOR_QUANTILE = 0.02
#: link length of connected points, as a share of the body's height
LINK_LENGTH = 0.06
#: least share of the scans' points inside the images of the cameras, and largest distance of a camera from
#: them, metres
MIN_VISIBLE_SHARE, MAX_CAMERA_DISTANCE = 0.5, 100.0

#: quantiles of the points that bound an extent, robust to outliers
EXTENT_QUANTILES = (0.01, 0.99)


class FitQuality(NamedTuple):
    """How well a body explains the points around it."""

    #: explained points as a share of the nearby points
    share: float
    #: the longest side of the bounding box of the explained points, as a share of the body's height
    length: float


def check_cameras(cameras: Sequence[Camera], clouds: Sequence[Float[np.ndarray, "_ 3"]], where: str) -> None:
    """Check that cameras can have taken the points of some scans, metres.

    `where` names the cameras in messages.

    **Raises:** `InputError` if a camera is so far away that its unit is wrong, looks away from or past all
    points, or if most points are in no image.
    """
    points = np.concatenate(clouds)
    middle = np.median(points, 0)
    for number, camera in enumerate(cameras):
        distance = float(np.linalg.norm(np.asarray(camera.eye) - middle))
        if distance > MAX_CAMERA_DISTANCE:
            raise InputError(
                f"{where}: camera {number} is {distance:.4g} m away from the scans; give translations in metres."
            )
    check_views(cameras, points, where)
    share = float(np.mean(within_aperture(cameras, points)))
    if share < MIN_VISIBLE_SHARE:
        raise InputError(
            f"{where}: {100 * (1 - share):.0f} % of the scans' points are outside the images of all cameras; "
            "give the cameras that took these scans."
        )


def check_actor(task: AdaptTask, state: AdaptState, where: str) -> None:
    """Check that the first scan shows one person, with the body after the stage `size`.

    `where` names the scan in messages.

    **Raises:** `InputError` if the body explains too few of the points around it, or if the scan contains
    another object that is like a person.
    """
    first = task.scanned[0]
    scan, height = task.scan(first), height_of(state.body)
    like, distances = fit_quality(state, first, scan)
    for rows in _other_objects(scan, distances, height):
        _refuse_person(task, scan, rows, where)
    if not is_person(like):
        raise InputError(
            f"{where}: this scan does not resemble a person. The best-fitting body is {height:.2f} m tall and explains "
            f"{100 * like.share:.0f} % of the nearby points, over a length of {like.length * height:.2f} m; expected at "
            f"least {100 * min_explained_share(like):.0f} %; give scans of one person without floor and walls, and their unit."
        )


def check_later_scans(task: AdaptTask, state: AdaptState, names: Sequence[str]) -> None:
    """Check that no scan after the first one contains a second person, with the poses after the stage `track`.

    `names` name the scans in messages. An object that stays in its position in scans that follow each other is fitted once,
    in the first scan by `check_actor`, and at most `MAX_OBJECTS` objects are.

    **Raises:** `InputError` if a scan contains another object that is like a person.
    """
    height, known, count = height_of(state.body), [], 0
    for number, frame in enumerate(task.scanned):
        scan = make_scan(thin_cloud(task.cloud(frame), NUM_CHECKED))
        like, distances = fit_quality(state, frame, scan)
        # a lost body leaves its own person
        for rows in _other_objects(scan, distances, height) if is_person(like) else ():
            middle = np.median(scan.points[rows], 0)
            near = any(np.linalg.norm(middle - other) < MIN_OBJECT_DISTANCE * height for other in known)
            if near and not task.settings.unordered:
                continue
            known.append(middle)
            if number:
                _refuse_person(task, scan, rows, names[frame])
                count += 1
            if count == MAX_OBJECTS:
                return


def _other_objects(
    scan: IndexedScan, distances: Float[np.ndarray, "N"], height: float
) -> list[Int[np.ndarray, "_"]]:
    """Find the points of objects away from the body that are as large as a person, largest first."""
    # a floor would link all objects on it
    floor = float(np.quantile(scan.points[:, 1], FLOOR_QUANTILE)) + LINK_LENGTH * height
    far = np.flatnonzero((distances > MIN_OBJECT_DISTANCE * height) & (scan.points[:, 1] > floor))
    return [far[group] for group in person_sized_groups(scan.points[far], height, len(scan.points))]


def _refuse_person(task: AdaptTask, scan: IndexedScan, rows: Int[np.ndarray, "_"], where: str) -> None:
    """Raise `InputError` if some points of a scan are a person's."""
    other = _fit_quality_alone(task, make_cloud(scan.points[rows], scan.normals[rows]))
    if is_person(other) and other.length >= MIN_FOLDED_EXTENT:
        place = ", ".join(f"{value:.2f}" for value in np.median(scan.points[rows], 0))
        raise InputError(
            f"{where}: this scan contains more than one person, another one near ({place}); crop the scans to "
            "one person."
        )


def min_explained_share(like: FitQuality) -> float:
    """Return the least share of nearby points to explain, given the length of the explained ones."""
    return MIN_EXPLAINED_WITH_LOAD if like.length >= MIN_EXTENT_WITH_LOAD else MIN_EXPLAINED


def is_person(like: FitQuality) -> bool:
    """Test if points that a body explains so well are a person's; boxes, balls, chairs and dogs are not."""
    return like.share >= min_explained_share(like)


def fit_quality(
    state: AdaptState, frame: int, scan: IndexedScan
) -> tuple[FitQuality, Float[np.ndarray, "N"]]:
    """Measure how well a posed body explains a scan; also return the distances of all points, metres."""
    posed, faces = pose_body(state.body, state.motion[frame]), np.asarray(state.body.faces)
    there = nearest_on_surface(scan.points, np.asarray(posed.vertices, float), faces)
    own = np.einsum("nk,nka->na", there.barycentric, np.asarray(posed.normals, float)[faces[there.triangles]])
    length, height = np.linalg.norm(own, axis=1), height_of(state.body)
    # an unknown normal matches any direction
    facing = np.sum(own * scan.normals, 1) >= MIN_NORMAL_COSINE * length
    facing |= ~scan.normals.any(1)
    around, good = (
        there.distances <= MIN_OBJECT_DISTANCE * height,
        facing & (there.distances <= MAX_EXPLAINED_DISTANCE * height),
    )
    if not good.any():
        return FitQuality(0.0, 0.0), there.distances
    low, high = np.quantile(scan.points[good], EXTENT_QUANTILES, axis=0)
    return FitQuality(float(good.sum() / around.sum()), float((high - low).max()) / height), there.distances


def height_of(body: Body) -> float:
    """Compute the longest side of the bounding box of a body at rest, metres."""
    return float(np.ptp(np.asarray(body.vertices, float), axis=0).max())


def person_sized_groups(
    points: Float[np.ndarray, "N 3"], height: float, num_scan_points: int
) -> list[Int[np.ndarray, "_"]]:
    """Find connected groups of points that may be a person about `height` metres tall, y up.

    Floors, walls and small groups are excluded. `num_scan_points` is the number of points of the scan. Return the rows
    of each group, largest first.
    """
    labels = connected_labels(points, LINK_LENGTH * height)
    found = []
    for label in np.unique(labels):
        rows = np.flatnonzero(labels == label)
        low, high = np.quantile(points[rows], EXTENT_QUANTILES, axis=0)
        size = high - low
        tall, slim = size[1] >= MIN_OBJECT_HEIGHT * height, max(size[0], size[2]) <= MAX_OBJECT_WIDTH * height
        if tall and slim and len(rows) >= MIN_OBJECT_SHARE * num_scan_points:
            found.append(rows)
    return sorted(found, key=len, reverse=True)


def _fit_quality_alone(task: AdaptTask, cloud: Cloud) -> FitQuality:
    """Fit the template, with its size, to a cloud alone and measure how well it explains it."""
    alone = task._replace(cloud=lambda _: cloud, num_frames=1, start=None, cameras=(), missing=(), mesh=None)
    return fit_quality(next(adapt_body(alone)), 0, make_scan(cloud))[0]
