"""The clouds or depth images of `jaxcap track`, and the floor in them."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ...body.body import Body
from ...depth.floor import find_floor_of_person
from ...io.archives.journal import read_header
from ...io.lazy_frames import LazyFrames
from ...io.meshes.clouds import read_clouds
from ...observe.clouds import Cloud
from ...observe.floor import find_floor, is_floor_of
from ...observe.floors_and_walls import remove_planes
from ...observe.planes import Plane
from ...tracking.people.track_people import MAX_PEOPLE
from ..depth.camera_agreement import describe_disagreement
from ..depth.sources import (
    DepthSources,
    describe_doubts,
    estimate_backgrounds,
    open_depth_sources,
    read_empty,
)
from ..sources import Clouds
from .depth import background_frames, depth_clouds, people_clouds, some_person
from .people import read_count

#: key of a journal's header with the normal and the offset of the floor
FLOOR_KEY = "floor"


class TrackInput(NamedTuple):
    """The frames of a sequence, read on access."""

    clouds: LazyFrames[Cloud]
    #: the depth images of the clouds, if there are any
    sources: DepthSources | None
    #: names of the images that show the background of the sequence itself
    images: list[str]
    #: what is not known of the background or of the cameras, in sentences without full stops
    doubts: list[str]


def open_input(track: Any, body: Body, others: set[int], journal: Path) -> TrackInput:
    """Open the clouds that the options of a tracking run name, or the depth images with their backgrounds.

    Frames that show a second person are added to `others` as they are read. **Raises:** `InputError`.
    """
    frames = (track.first, track.last)
    if not track.depth:
        clouds = Clouds(read_clouds(track.clouds, *frames, track.unit), body, track.up)
        return TrackInput(clouds, None, [], [])
    sources = open_depth_sources(track.depth, track.cameras, track.masks, track.depth_scale, frames, track.up)
    numbers: list[int] = []
    if track.empty:
        backgrounds = read_empty(sources.cameras, sources.recorded, track.empty, track.depth_scale)
    else:
        if track.background == "auto":
            numbers = background_frames(sources, journal, track.resume)
        backgrounds = estimate_backgrounds(sources, numbers)
    if track.people is None:
        clouds = depth_clouds(sources, backgrounds, body, others)
    else:
        clouds = people_clouds(sources, backgrounds, body, read_count(track.people) or MAX_PEOPLE)
    names = [Path(sources.images.names[number]).name for number in numbers]
    doubts = describe_doubts(backgrounds) + describe_disagreement(clouds, len(track.depth))
    return TrackInput(clouds, sources, names, doubts)


def floor_below_person(
    found: TrackInput, planes: Sequence[Plane], journal: Path, resume: bool
) -> Plane | None:
    """Find the floor on which the person of a frame is: among the `planes` of the clouds, or in the depth images.

    A resumed run uses the one with which it began: other frames may show another one.
    """
    if resume and journal.is_file():
        begun = read_header(journal).get(FLOOR_KEY)
        return Plane(np.asarray(begun[:3]), float(begun[3])) if isinstance(begun, list) else None
    shown = some_person(found.clouds)
    if shown is None:
        return None
    number, cloud = shown
    if found.sources is not None:
        return find_floor_of_person(found.sources.cameras, found.sources.images[number].depths, cloud)
    floor = find_floor(list(planes))
    points, person = (
        np.asarray(one.points, float)[np.asarray(one.weights) > 0]
        for one in (cloud, remove_planes(cloud, planes))
    )
    return floor if floor is not None and len(person) and is_floor_of(floor, points, person) else None
