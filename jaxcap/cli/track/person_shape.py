"""The shape of the person, estimated before tracking."""

from pathlib import Path

from ...adapt.shape.tracked_shape import estimate_shape
from ...body.body import Body
from ...errors import InputError
from ...io.archives.npz import save_body
from ...io.lazy_frames import LazyFrames
from ...observe.clouds import Cloud
from ...tracking.track_frame import Tracker
from ..console.console import say
from ..console.heartbeat import set_activity
from ..sources import load_body

#: number of frames from which the shape of a person is estimated
SHAPE_FRAMES = 40


def find_person_shape(path: Path, tracker: Tracker, clouds: LazyFrames[Cloud]) -> Body:
    """Estimate the shape of the person from the first frames and write it to `path`, or read it if an earlier run did."""
    if not path.is_file():
        set_activity("estimating the shape of the person")
        save_body(path, estimate_shape(tracker, first_readable(clouds, SHAPE_FRAMES)))
        say(f"the shape of the person is in {path}; the frames are now tracked with it")
    # the written body, so that a resumed run has the same one
    return load_body(str(path))[0]


def first_readable(clouds: LazyFrames[Cloud], count: int) -> list[Cloud]:
    """Read the first `count` clouds of a person, or those before the first that cannot be read, which tracking reports."""
    found = []
    for number in range(len(clouds)):
        try:
            cloud = clouds[number]
        except InputError:
            break
        found += [] if cloud.missing else [cloud]
        if len(found) == count:
            break
    return found
