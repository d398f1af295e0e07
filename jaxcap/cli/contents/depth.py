"""Text descriptions of depth images, and of the people and the room in them."""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ...depth.back_projection import world_points
from ...depth.background import Background, estimate_background, farthest_depths
from ...depth.candidates import PERSON, PIECE, join_candidates
from ...depth.check_depths import check_depth_scale, depth_excess
from ...depth.person import search_person
from ...errors import InputError, user_message
from ...geometry.camera import Camera
from ...geometry.sampling import even_indices
from ...io.cameras import read_cameras
from ...io.depth.recording import is_recording
from ...io.depth.rectify import rectify_depths
from ...io.depth.sequence import DepthFrame, read_depths
from ...observe.floor import find_floor
from ...observe.planes import find_planes, refine_plane
from ..console.console import pluralise, say
from ..console.heartbeat import set_activity
from .listing import Contents

#: largest number of frames that are examined, and of frame numbers in a sentence
MAX_EXAMINED, MAX_NAMED = 20, 10
#: the kind of depth images that show no person, and of those in another unit that no option changes
NOBODY, NOT_METRES = "depth without a person", "depth in another unit"
#: names of units by their number in a metre
_UNITS = {1.0: "metres", 100.0: "centimetres", 1000.0: "millimetres", 10000.0: "tenths of a millimetre"}


class DepthOptions(NamedTuple):
    """The camera and the unit of depth images."""

    cameras: Path | None = None
    scale: float = 1000.0


def describe_depth(source: str | Path, options: DepthOptions, camera: int = 0) -> Contents:
    """Print the number and the size of depth images, and the range of the first one's depths, and return their contents.

    With the intrinsics of the `camera` of that number print the floor, the background and the people in some frames.
    """
    kind = "depth recording" if is_recording(source) else "depth"
    images = read_depths(source, depth_scale=options.scale)
    is_scaled = _is_scaled(source, options.scale, images[0].depths[0])
    cameras = _cameras(source, options)
    if cameras and camera < len(cameras):
        rectified, images = rectify_depths([cameras[camera]], images)
        if cameras[camera].lens is not None:
            say("the lens of the camera distorts its images; the following is of the rectified ones")
        cameras[camera] = rectified[0]
    frame = images[0]
    depth = frame.depths[0]
    measured = depth[depth > 0]
    say(f"{pluralise(len(images), 'depth image')} of {depth.shape[1]} x {depth.shape[0]} pixels")
    if len(measured):
        low, middle, high = np.percentile(measured, [1, 50, 99])
        unit = _UNITS.get(options.scale, f"1 / {options.scale:g} of a metre")
        condition = f", if its whole numbers are {unit}" if is_scaled else ""
        say(
            f"the first has depths of {low:.2f} to {high:.2f} m, median {middle:.2f} m{condition}; {100 * len(measured) / depth.size:.0f} % of its pixels were measured"
        )
    if frame.masks[0] is not None:
        say(f"masks of the person; in the first one {100 * frame.masks[0].mean():.0f} % of the pixels")
    try:
        check_depth_scale(depth, "the first image")
    except InputError as error:
        say(user_message(error))
        right = float(f"{options.scale * depth_excess(depth):.12g}")
        if not is_scaled:
            return Contents(NOT_METRES)
        default = ", which is the default" if right == DepthOptions().scale else ""
        say(f"the following commands have --depth-scale {right:g}{default}")
        return Contents(kind, depth_scale=right)
    if not cameras:
        say("the intrinsics of the camera (--cameras) are needed to find the floor and the person")
        return Contents(kind)
    if camera >= len(cameras):
        raise InputError(
            f"{options.cameras}: there are {len(cameras)} cameras; expected one for each folder of images."
        )
    set_activity("searching for the floor and the person")
    numbers = even_indices(len(images), MAX_EXAMINED, nearest=True).tolist()
    frames = {number: images[number] for number in numbers}
    return Contents(kind if _describe_room(cameras[camera], frames) else NOBODY)


def _is_scaled(source: str | Path, scale: float, depth: np.ndarray) -> bool:
    """Test if the depths of the first image depend on the number of units in a metre: those of whole numbers do."""
    if is_recording(source):
        # a second search for the times of its images takes long
        return Path(source).suffix.lower() != ".mkv"
    return not np.array_equal(read_depths(source, depth_scale=2 * scale)[0].depths[0], depth)


def _cameras(source: str | Path, options: DepthOptions) -> list[Camera]:
    """Read the given cameras, or those of a recording; none if neither is there."""
    path = source if options.cameras is None and is_recording(source) else options.cameras
    return [] if path is None else read_cameras(path)


def describe_camera_depth(source: str | Path, options: DepthOptions) -> Contents:
    """Describe the images of one camera as `describe_depth` does; `options.cameras` may have no other."""
    if options.cameras is not None and (count := len(read_cameras(options.cameras))) != 1:
        raise InputError(
            f"{options.cameras}: there are {count} cameras, but the images of one are described; give the intrinsics of that "
            "camera, or describe the folder of `jaxcap scan`."
        )
    return describe_depth(source, options)


def _describe_room(camera: Camera, frames: dict[int, DepthFrame]) -> bool:
    """Print the floor, the background and the people. Return whether there are people."""
    depths = [frame.depths[0] for frame in frames.values()]
    background = estimate_background(camera, depths)
    far, _ = farthest_depths(np.stack(depths), 1)
    eye = np.asarray(camera.eye, float)
    points = world_points(camera, far)[far > 0]
    floor = find_floor(find_planes(points, eye))
    if floor is None:
        say(
            "floor: none was found, so the tilt of the camera is not known, and feet are not kept above a floor"
        )
    else:
        floor = refine_plane(floor, points)
        tilt = np.degrees(np.arccos(np.clip(floor.normal[1], -1.0, 1.0)))
        say(
            f"floor: {eye @ floor.normal - floor.offset:.2f} m below the camera; its normal is {tilt:.0f} degrees from the "
            "vertical of the camera's world"
        )
    if background.doubt:
        say(f"background: not known; {background.doubt}")
    else:
        known = 100 * np.mean(background.depth[far > 0] > 0)
        say(f"background: {known:.0f} % of the measured pixels show surface that never moves and is nobody")
    return _describe_people(camera, frames, background)


def _describe_people(camera: Camera, frames: dict[int, DepthFrame], background: Background) -> bool:
    people, nobody = [], []
    for number, frame in frames.items():
        steps = search_person(camera, frame.depths[0], background, frame.name)
        found = [one for one in steps.candidates if one.found in (PERSON, PIECE)]
        if found:
            people.append(join_candidates(found))
        else:
            nobody.append(number)
    if people:
        extent, area, distance = (
            float(np.median([getattr(one, name) for one in people]))
            for name in ("extent", "area", "distance")
        )
        what, doubt = "a person", ""
        if background.doubt:
            what = "a surface of a person's size"
            doubt = "; it may be furniture, as the background is not known"
        say(
            f"{what} was found in {len(people)} of the {pluralise(len(frames), 'frame')} that were examined: {extent:.2f} m "
            f"long, {area:.2f} m² of visible surface, {distance:.1f} m away{doubt}"
        )
    if nobody:
        say(f"no surface has the size of a person in {_named(nobody)}, counted from 0")
    return bool(people)


def _named(numbers: Sequence[int]) -> str:
    more = f" and {len(numbers) - MAX_NAMED} others" if len(numbers) > MAX_NAMED else ""
    return f"{'frame' if len(numbers) == 1 else 'frames'} {', '.join(map(str, numbers[:MAX_NAMED]))}{more}"
