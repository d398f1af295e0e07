"""Standard deviations of the coefficients and joints of several people."""

import functools
from collections.abc import Callable, Sequence

from jaxtyping import Float
from numpy import ndarray

from ...io.lazy_frames import LazyFrames
from ...observe.clouds import Cloud
from ...observe.floors_and_walls import remove_planes
from ...observe.planes import Plane
from ...tracking.advance import make_follower
from ...tracking.people.person_frame import PersonFrame, present_people
from ...tracking.people.scene import person_cloud, share_points
from ...tracking.track_frame import Tracker
from .frame_records import unpack

#: frames whose points are kept divided between people
NUM_KEPT = 64


def divide_clouds(
    trackers: Sequence[Tracker],
    template: tuple[PersonFrame, ...],
    rows: Float[ndarray, "N R"],
    clouds: LazyFrames[Cloud],
    planes: Sequence[Plane] = (),
) -> Callable[[int, int], Cloud]:
    """Make a function of a person and a frame that weights the points of the frame for that person.

    **Arguments:** `rows`, the frames of all people as in the journal; `planes`, floors and walls that are not tracked.
    """
    followers = [make_follower(tracker) for tracker in trackers]

    @functools.lru_cache(maxsize=NUM_KEPT)
    def divide(frame: int):
        cloud = remove_planes(clouds[frame], planes)
        people = unpack(template, rows[frame])[0]
        states = {k: people[k].tracked.state.estimate for k in present_people(people)}
        poses = {k: one.pose for k, one in states.items()}
        return cloud, share_points(followers, poses, {k: one.sigma for k, one in states.items()}, cloud)

    return lambda person, frame: person_cloud(*divide(frame), person)
