"""The shapes of the people, estimated before tracking."""

import itertools
from collections.abc import Iterator
from pathlib import Path

from ...adapt.shape.people_shapes import estimate_people_shapes
from ...adapt.shape.tracked_shape import estimate_shape
from ...body.body import Body
from ...body.body_model import BodyModel
from ...errors import InputError
from ...io.archives.npz import save_body
from ...io.lazy_frames import LazyFrames
from ...observe.clouds import Cloud
from ...tracking.track_frame import Tracker
from ..console.console import pluralise, say
from ..console.heartbeat import set_activity
from ..sources import load_body
from .results import PERSON, make_writable, person_folder

#: number of frames from which the shape of a person is estimated
SHAPE_FRAMES = 40


def find_shapes(
    folder: Path,
    model: BodyModel | None,
    tracker: Tracker,
    clouds: LazyFrames[Cloud],
    num_people: int | None,
    *,
    several: bool,
) -> list[Body]:
    """Estimate the shapes of one person or of several, or read those of an earlier run.

    **Arguments:** `model`, the body model of the tracked body, None for humans; `num_people`, None if unknown.
    """
    if several:
        return find_people_shapes(folder, model, tracker, clouds, num_people)
    return [find_person_shape(folder / PERSON, model, tracker, clouds)]


def find_person_shape(
    path: Path, model: BodyModel | None, tracker: Tracker, clouds: LazyFrames[Cloud]
) -> Body:
    """Estimate the shape of the person from the first frames and write it to `path`, or read it if an earlier run did."""
    if not path.is_file():
        set_activity("estimating the shape of the person")
        save_body(path, estimate_shape(tracker, first_readable(clouds, SHAPE_FRAMES), model))
        say(f"the shape of the person is in {path}; the frames are now tracked with it")
    # the written body, so that a resumed run has the same one
    return load_body(str(path))[0]


def find_people_shapes(
    folder: Path,
    model: BodyModel | None,
    tracker: Tracker,
    clouds: LazyFrames[Cloud],
    num_people: int | None,
) -> list[Body]:
    """Estimate the shape of each person as `find_person_shape` does of one, or read those of an earlier run.

    They are written to the folders of the people. Fewer than `num_people` may be found: the others keep the body of the tracker.
    """
    paths = list(
        itertools.takewhile(Path.is_file, (person_folder(folder, k) / PERSON for k in itertools.count()))
    )
    if not paths:
        set_activity("estimating the shapes of the people")
        found = estimate_people_shapes(tracker, first_readable(clouds, SHAPE_FRAMES), num_people, model)
        paths = [person_folder(folder, number) / PERSON for number in range(len(found))]
        # the first one is written last, so that an interrupted run estimates all shapes again
        for path, body in reversed(list(zip(paths, found, strict=True))):
            make_writable(path.parent)
            save_body(path, body)
        people = pluralise(len(found), "person", "people")
        say(f"the shapes of {people} are in {paths[0]}{' and so on' if len(paths) > 1 else ''}")
    bodies = [load_body(str(path))[0] for path in paths]
    return bodies + [tracker.body] * ((num_people or len(bodies)) - len(bodies))


def first_readable(clouds: LazyFrames[Cloud], count: int) -> list[Cloud]:
    """Read the first `count` clouds of a person, or those before the first that cannot be read, which tracking reports."""
    return [cloud for _, cloud in itertools.islice(people_until_unreadable(clouds), count)]


def people_until_unreadable(clouds: LazyFrames[Cloud]) -> Iterator[tuple[int, Cloud]]:
    """Yield the clouds that show a person with their numbers, up to the first cloud that cannot be read."""
    for number in range(len(clouds)):
        try:
            cloud = clouds[number]
        except InputError:
            return
        if not cloud.missing:
            yield number, cloud
