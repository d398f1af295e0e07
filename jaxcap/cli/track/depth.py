"""The frames of depth images as clouds of the person, read on access."""

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from ...body.body import Body
from ...depth.background import MAX_FRAMES, Background, spread_frames
from ...depth.clouds import cloud_of_depths
from ...errors import InputError
from ...fit.tracking.check_cloud import check_cloud
from ...io.archives.journal import read_header
from ...io.lazy_frames import LazyFrames
from ...observe.clouds import Cloud, missing_cloud
from ..console.console import warn
from ..console.heartbeat import set_activity
from ..depth.sources import DepthSources, choose_frames

#: key of a journal's header with the names of the images that show the background
BACKGROUND_KEY = "background images"


def depth_clouds(
    sources: DepthSources, backgrounds: Sequence[Background | None], body: Body
) -> LazyFrames[Cloud]:
    """Make clouds of the person with their depth images. A frame without a person is a `missing_cloud`."""
    dofs = body.skeleton.num_dofs

    def load(number: int) -> Cloud:
        frame = sources.images[number]
        cloud = cloud_of_depths(
            sources.cameras,
            frame.depths,
            frame.masks,
            backgrounds=backgrounds,
            name=frame.name,
            keep_missing=True,
        )
        if cloud.missing:
            return cloud
        count = int((cloud.weights > 0).sum())
        if count < dofs:
            return missing_cloud(
                f"{frame.name}: the person has {count} points, fewer than the {dofs} parameters of the pose.",
                cloud.views,
            )
        check_cloud(body, cloud, frame.name)
        return cloud

    return LazyFrames(sources.images.names, load)


def background_frames(sources: DepthSources, journal: Path, resume: bool) -> list[int]:
    """Choose the frames that show the background; a resumed run uses those with which it began.

    Images that were added since would change the background, and so the points of all frames.
    """
    if not (resume and journal.is_file()):
        return choose_frames(sources)
    begun = read_header(journal).get(BACKGROUND_KEY)
    names = set(begun) if isinstance(begun, list) else set()
    return [number for number, name in enumerate(sources.images.names) if Path(name).name in names]


def check_some_person(clouds: LazyFrames[Cloud], first: Cloud) -> None:
    """Check that the first frame, or one of some spread ones, shows a person. Raises `InputError`."""
    if not first.missing:
        return
    set_activity("searching for a frame with a person")
    numbers = spread_frames(len(clouds), MAX_FRAMES)
    if not any(_shows_person(clouds, number) for number in numbers):
        raise InputError(
            f"{first.missing} The same holds for all of the {len(numbers)} frames that were tried."
        )


def _shows_person(clouds: LazyFrames[Cloud], number: int) -> bool:
    try:
        return not clouds[number].missing
    except InputError:
        # tracking reports it
        return False


def announce_missing(clouds: Iterator[Cloud]) -> Iterator[Cloud]:
    """Yield clouds, and print the reason of the first of consecutive frames without a person.

    Print also which cameras see no person in the first `MAX_FRAMES` frames that show one.
    """
    before, count, blind = False, 0, set[int]()
    for cloud in clouds:
        if cloud.missing and not before:
            warn(f"{cloud.missing} The frame is lost, and keeps the pose of the frame before.")
        before = bool(cloud.missing)
        if not before and count < MAX_FRAMES:
            here = {number for number, view in enumerate(cloud.views) if not np.asarray(view.depth).any()}
            blind = here if count == 0 else blind & here
            count += 1
            if count == MAX_FRAMES:
                _warn_of_blind(blind, count)
        yield cloud
    if count < MAX_FRAMES:
        _warn_of_blind(blind, count)


def _warn_of_blind(cameras: set[int], count: int) -> None:
    for number in sorted(cameras):
        warn(
            f"camera {number} saw no person in {count} frames in which other cameras saw one; if it looks away, correct its "
            "position and direction, or leave it out"
        )
