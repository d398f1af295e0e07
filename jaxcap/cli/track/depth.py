"""The frames of depth images as clouds of the person, read on access."""

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float

from ...body.body import Body
from ...depth.background import MAX_FRAMES, Background
from ...depth.clouds import cloud_of_depths
from ...depth.people import choose_people, find_people
from ...depth.person import PersonSearch
from ...depth.views import blank_view
from ...errors import InputError, NoPersonError, user_message
from ...geometry.camera import Camera
from ...geometry.sampling import even_indices
from ...io.archives.journal import read_header
from ...io.lazy_frames import LazyFrames
from ...observe.clouds import Cloud, missing_cloud
from ...tracking.check_cloud import check_cloud
from ..console.console import warn
from ..console.heartbeat import set_activity
from ..depth.sources import DepthSources, choose_frames

#: a person is rarely nearer to a depth camera, metres
MIN_DISTANCE = 0.3
#: key of a journal's header with the names of the images that show the background
BACKGROUND_KEY = "background images"


def depth_clouds(
    sources: DepthSources, backgrounds: Sequence[Background | None], body: Body, others: set[int]
) -> LazyFrames[Cloud]:
    """Make clouds of the person with their depth images. A frame without a person is a `missing_cloud`.

    The numbers of frames without a mask that show a second person are added to `others` as they are read.
    """

    def load(number: int) -> Cloud:
        frame = sources.images[number]

        def look_for_others(search: PersonSearch) -> None:
            if len(choose_people(search.candidates, 2)) > 1:
                others.add(number)

        cloud = cloud_of_depths(
            sources.cameras,
            frame.depths,
            frame.masks,
            backgrounds=backgrounds,
            name=frame.name,
            keep_missing=True,
            on_search=look_for_others,
        )
        return _check(cloud, body, frame.name)

    return LazyFrames(sources.images.names, load)


def people_clouds(
    sources: DepthSources, backgrounds: Sequence[Background | None], body: Body, count: int
) -> LazyFrames[Cloud]:
    """Make clouds of at most `count` people, as `depth_clouds` makes them of one."""

    def load(number: int) -> Cloud:
        frame = sources.images[number]
        masks, reasons = [], []
        for camera, depth, background, mask, file in zip(
            sources.cameras, frame.depths, backgrounds, frame.masks, frame.files, strict=True
        ):
            try:
                masks.append(_people(camera, depth, background, count, file) if mask is None else mask)
            except NoPersonError as error:
                masks.append(np.zeros(depth.shape, bool))
                reasons.append(user_message(error))
        if len(reasons) == len(masks):
            return missing_cloud(reasons[0], tuple(blank_view(camera) for camera in sources.cameras))
        # two cameras may see different people
        cloud = cloud_of_depths(
            sources.cameras, frame.depths, masks, name=frame.name, keep_missing=True, max_apart=np.inf
        )
        return _check(cloud, body, frame.name)

    return LazyFrames(sources.images.names, load)


def _people(
    camera: Camera, depth: Float[np.ndarray, "H W"], background: Background | None, count: int, where: str
) -> Bool[np.ndarray, "H W"]:
    """Find the pixels of at most `count` people in an image. Raises `InputError` as `find_people`."""
    return np.any(find_people(camera, depth, count, where, background=background), axis=0)


def _check(cloud: Cloud, body: Body, name: str) -> Cloud:
    """Check a cloud; one with too few points is a `missing_cloud`. Raises `InputError`."""
    dofs = body.skeleton.num_dofs
    count = int((cloud.weights > 0).sum())
    if not cloud.missing and count < dofs:
        reason = f"{name}: the person has {count} points, fewer than the {dofs} parameters of the pose."
        return missing_cloud(reason, cloud.views)
    if not cloud.missing:
        check_cloud(body, cloud, name)
    return cloud


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
    if first.missing and some_person(clouds) is None:
        count = len(even_indices(len(clouds), MAX_FRAMES, nearest=True))
        raise InputError(f"{first.missing} The same holds for all of the {count} frames that were tried.")


def some_person(clouds: LazyFrames[Cloud]) -> tuple[int, Cloud] | None:
    """Return the first cloud that shows a person, among at most `MAX_FRAMES` spread ones, with its number; None if none does."""
    set_activity("searching for a frame with a person")
    for number in even_indices(len(clouds), MAX_FRAMES, nearest=True).tolist():
        try:
            cloud = clouds[number]
        except InputError:
            # tracking reports it
            continue
        if not cloud.missing:
            return number, cloud
    return None


def describe_distance(cloud: Cloud) -> list[str]:
    """Describe in a sentence without a full stop that the person is nearer to all cameras than depth cameras measure."""
    points = np.asarray(cloud.points, float)[np.asarray(cloud.weights) > 0]
    eyes = [np.asarray(view.camera.eye, float) for view in cloud.views]
    if not eyes or not len(points):
        return []
    nearest = max(float(np.median(np.linalg.norm(points - eye, axis=1))) for eye in eyes)
    if nearest >= MIN_DISTANCE:
        return []
    return [
        f"the person is {nearest:.2f} m away from the camera, and few depth cameras measure less than {MIN_DISTANCE:g} m; check "
        "--depth-scale"
    ]


def announce_missing(clouds: Iterator[Cloud]) -> Iterator[Cloud]:
    """Yield clouds, and print the reason of the first of consecutive frames without a person."""
    before = False
    for cloud in clouds:
        if cloud.missing and not before:
            warn(f"{cloud.missing} The frame is lost, and keeps the pose of the frame before.")
        before = bool(cloud.missing)
        yield cloud


def announce_blind(clouds: Iterator[Cloud]) -> Iterator[Cloud]:
    """Yield clouds, and print which cameras see no person in the first `MAX_FRAMES` frames that show one."""
    count, blind = 0, set[int]()
    for cloud in clouds:
        if not cloud.missing and count < MAX_FRAMES:
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
