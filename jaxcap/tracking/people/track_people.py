"""Tracking of several people in a stream of clouds."""

import functools
from collections.abc import Callable, Iterable, Iterator, Sequence

import jax.numpy as jnp

from ...arguments import checked
from ...body.pose import Pose
from ...errors import InputError
from ...observe import Scan
from ...observe.clouds import Cloud
from ...observe.floors_and_walls import without_room
from ...observe.planes import Plane
from ...value_checks import check_at_least, check_direction
from ..advance import FirstSearch, Follower, Search, find_first_frame, make_follower
from ..check_cloud import check_cloud
from ..track import iterate_clouds
from ..track_frame import Tracker, check_sigma
from .enter import enter_people, find_newcomers, points_of
from .person_frame import PersonFrame, absent_person, enter
from .scene import advance_people, divide_points, no_occluders, person_cloud, person_size, share_points

#: largest number of people if it is not given
MAX_PEOPLE = 6


@checked
def track_people(
    trackers: Tracker | Sequence[Tracker],
    clouds: Iterable[Cloud | Scan] | Cloud,
    num_people: int | None = None,
    start: Sequence[Pose] | Sequence[PersonFrame] | None = None,
    *,
    search: FirstSearch = "auto",
    sigma: float = 0.1,
    up: tuple[float, float, float] = (0.0, 1.0, 0.0),
    first: int = 0,
    on_search: Callable[[int, Search], None] | None = None,
    planes: Sequence[Plane] | None = None,
) -> Iterator[tuple[PersonFrame, ...]]:
    """Track several people in a stream of clouds; yield the frame of each person as soon as all are done.

    The people are classes of one mixture, each with own outliers: a point has a share in each person by the densities of
    all (`responsibilities`), and each person is tracked by `advance_frame` with the own share of the points. People are
    found by connected groups of points; somebody may come in, leave, and return at any time. Each is judged with the
    others as occluders. Where people were near each other, an exchange is tested for: if the bodies differ, it is found
    and corrected; if the bodies are equal and somebody was hidden, it is given as a reason (`PersonFrame.reasons`).

    **Arguments:** `trackers`, one for all people, or one for each, who are then distinguished by their bodies;
    `num_people`, the largest number of people; without it and with one tracker, people are found up to `MAX_PEOPLE`, and
    the tuple grows as they come in; `start`, a first pose for each person, or the last frames of an interrupted run;
    `on_search` is called before every search with the number of the person; the others are those of `track_frames`.

    **Raises:** `InputError` for another number of trackers or starts than of people, and the errors of `track_frames`.
    """
    where = "track_people"
    check_sigma(where, sigma)
    check_direction(where, up=up)
    alike = isinstance(trackers, Tracker)
    if num_people is not None:
        check_at_least(where, 1, num_people=num_people)
    if not alike and (not trackers or num_people not in (None, len(trackers))):
        raise InputError(
            f"{where}: there are {len(trackers)} trackers, but `num_people` is {num_people}; give one tracker, or one for "
            "each person."
        )
    given = None if start is None else len(start)
    count = num_people or (len(trackers) if not alike else None)
    if given is not None and given != (given if count is None else count):
        raise InputError(f"{where}: there are {given} starts; expected {count}, one for each person.")
    poses = start is not None and len(start) > 0 and isinstance(start[0], Pose)
    known = next((len(one.contacts) for one in start or () if isinstance(one, PersonFrame)), MAX_PEOPLE)
    size = count or (given if poses and given else known)
    followers = _make_followers([trackers] * size if alike else list(trackers), up, on_search)
    cleared = without_room(iterate_clouds(clouds), planes)
    return _track_people(followers, cleared, start, search, sigma, first, grows=count is None and not poses)


def _make_followers(
    trackers: Sequence[Tracker],
    up: tuple[float, float, float],
    on_search: Callable[[int, Search], None] | None,
) -> list[Follower]:
    """Make the constants of each person; those of one tracker share their samples."""
    made: dict[int, Follower] = {}
    followers = []
    for number, tracker in enumerate(trackers):
        if id(tracker) not in made:
            made[id(tracker)] = make_follower(tracker, up)
        announce = None if on_search is None else functools.partial(on_search, number)
        followers.append(made[id(tracker)]._replace(on_search=announce))
    return followers


def _track_people(
    followers: Sequence[Follower],
    clouds: Iterable[Cloud],
    start: Sequence[Pose] | Sequence[PersonFrame] | None,
    search: FirstSearch,
    sigma: float,
    first: int,
    grows: bool,
) -> Iterator[tuple[PersonFrame, ...]]:
    """Track as `track_people` does, after its checks; if the number of people `grows`, only those seen are yielded."""
    people: list[PersonFrame] = []
    for number, cloud in enumerate(clouds, first):
        if not cloud.missing:
            check_cloud(followers[0].tracker.body, cloud, f"cloud {number}")
        poses = None
        if not people:
            people = [
                absent_person(one.tracker, one.surface, len(followers), len(cloud.views)) for one in followers
            ]
            given = [one for one in start or () if isinstance(one, PersonFrame)]
            people[: len(given)] = given
            poses = [one for one in start or () if isinstance(one, Pose)]
        if poses:
            people = _start_at(followers, people, poses, cloud, number, search, sigma)
        else:
            divided = divide_points(followers, people, cloud)
            newcomers = find_newcomers(followers, people, cloud, divided)
            excluded = points_of(newcomers)
            people = advance_people(followers, people, cloud, divided, number, excluded)
            people = enter_people(followers, people, newcomers, number, search=search, sigma=sigma)
        yield tuple(person for person in people if person.seen or not grows)


def _start_at(
    followers: Sequence[Follower],
    people: Sequence[PersonFrame],
    poses: Sequence[Pose],
    cloud: Cloud,
    number: int,
    search: FirstSearch,
    sigma: float,
) -> list[PersonFrame]:
    """Track the first frame from given poses."""
    sigmas = {k: jnp.asarray(sigma, pose.rotations.dtype) for k, pose in enumerate(poses)}
    divided = share_points(followers, dict(enumerate(poses)), sigmas, cloud)
    started = list(people)
    for k, pose in enumerate(poses):
        own = person_cloud(cloud, divided, k)
        hiding = no_occluders(followers[k], len(people))
        frame = find_first_frame(
            followers[k], own, pose, number, search=search, sigma=sigma, occluders=hiding
        )
        started[k] = enter(people[k], frame, person_size(cloud, divided, k))
    return started
