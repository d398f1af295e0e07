"""Floors and walls in point clouds of a room, found once and removed from every frame."""

from collections.abc import Iterable, Iterator, Sequence

import numpy as np

from ..arguments import checked
from .clouds import Cloud, ordered_cloud
from .floor import MAX_FLOOR_TILT
from .planes import MIN_ROOM_SHARE, PLANE_DISTANCE, Plane, find_planes, in_room, refine_plane


@checked
def find_room(cloud: Cloud) -> tuple[Plane, ...]:
    """Find floors and walls in one cloud: wide planes with many points that have the normal of the plane.

    Clouds of depth images have none, because their floors and walls are removed when the person is found. In clouds without
    normals none are found.
    """
    if cloud.missing or cloud.views:
        return ()
    points, normals, _ = _arrays(cloud)
    found = find_planes(points, normals=normals, min_share=MIN_ROOM_SHARE)
    planes: list[Plane] = []
    for plane in (refine_plane(plane, points) for plane in found):
        if not any(_is_same(plane, other) for other in planes):
            planes.append(plane)
    return tuple(planes)


def _is_same(one: Plane, other: Plane) -> bool:
    """Test if two planes are one surface that was found twice because of its noise."""
    return bool(one.normal @ other.normal > 0.98 and abs(one.offset - other.offset) < 4 * PLANE_DISTANCE)


@checked
def remove_planes(cloud: Cloud, planes: Sequence[Plane]) -> Cloud:
    """Remove the points on planes and behind them. Return the cloud unchanged if no point would remain.

    Points farther from a plane than its noise that have another normal stay, such as those of a foot on the floor.
    """
    if not planes or cloud.missing:
        return cloud
    points, normals, weights = _arrays(cloud)
    kept = ~in_room(points, normals, planes)
    if kept.all() or not kept.any():
        return cloud
    return ordered_cloud(points[kept], normals[kept], weights[kept])


def without_room(clouds: Iterable[Cloud], planes: Sequence[Plane] | None) -> Iterator[Cloud]:
    """Yield clouds without the points on `planes`; None takes the floors and walls of the first cloud."""
    for cloud in clouds:
        if planes is None and not cloud.missing:
            planes = find_room(cloud)
        yield remove_planes(cloud, planes or ())


def describe_room(cloud: Cloud, planes: Sequence[Plane]) -> str:
    """Describe the planes of a cloud: kinds and share of the points, y up; without a full stop."""
    points, normals, _ = _arrays(cloud)
    share = float(np.mean(in_room(points, normals, planes)))
    floors = sum(abs(plane.normal[1]) >= np.cos(np.radians(MAX_FLOOR_TILT)) for plane in planes)
    names = {"floor or ceiling": floors, "wall": len(planes) - floors}
    named = " and ".join(
        f"a {name}" if count == 1 else f"{count} {name}s" for name, count in names.items() if count
    )
    return f"{named} with {100 * share:.0f} % of the points of the first cloud"


def _arrays(cloud: Cloud) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return points, normals and weights without padding, in the precision of the cloud."""
    weights = np.asarray(cloud.weights)
    real = weights > 0
    return np.asarray(cloud.points)[real], np.asarray(cloud.normals)[real], weights[real]
