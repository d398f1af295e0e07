"""Shapes of several people from a sequence of clouds that shows all of them."""

import logging
import warnings
from collections.abc import Sequence
from typing import NamedTuple

import jax.numpy as jnp

from ...arguments import checked
from ...body.body import Body
from ...body.body_model import BodyModel
from ...body.pose import Pose
from ...errors import InputError
from ...observe.clouds import Cloud
from ...observe.floors_and_walls import without_room
from ...tracking.advance import FirstSearch, make_follower
from ...tracking.people.person_frame import APART, present_people
from ...tracking.people.scene import person_cloud, share_points
from ...tracking.people.track_people import track_people
from ...tracking.track_frame import Tracker, replace_body
from ...value_checks import check_at_least
from .tracked_shape import NUM_FRAMES, find_space, fit_to_some

_LOG = logging.getLogger(__name__)


class _OwnFrames(NamedTuple):
    """The frames of one person, by number: poses, and clouds with the weights of this person's points."""

    #: frames with the verdict `good`, away from other people and next to them
    separate: dict[int, Pose]
    touching: dict[int, Pose]
    #: frames with other verdicts
    others: dict[int, Pose]
    clouds: dict[int, Cloud]

    @property
    def good(self) -> dict[int, Pose]:
        """The frames that show the shape of the person: those in which it touches others only if there are no others."""
        return self.separate or self.touching

    def add(self, number: int, pose: Pose, verdict: str, is_near: bool) -> None:
        """Add the pose of a frame with a verdict, in which the person is near another one or not."""
        frames = self.others if verdict != "good" else self.touching if is_near else self.separate
        frames[number] = pose


@checked
def estimate_people_shapes(
    tracker: Tracker,
    clouds: Sequence[Cloud],
    num_people: int | None = None,
    space: BodyModel | None = None,
    *,
    num_frames: int = NUM_FRAMES,
    search: FirstSearch = "auto",
    up: tuple[float, float, float] = (0.0, 1.0, 0.0),
) -> list[Body]:
    """Estimate the shape of each of several people from a short sequence of clouds, without first poses.

    The people are tracked by `tracker`, all with its body (`track_people`). The points of each frame are divided between
    them, and the shape of each person is fitted to the own points, as `estimate_shape` does for one person. Frames in which
    people touch are used only if there are no others. Track the sequence anew with one tracker for each returned body.

    **Arguments:** `clouds`, consecutive frames; `num_people`, the largest number of people, found if not given; the others
    as of `estimate_shape`.

    **Returns:** the bodies of the people that were found, in the order in which they were.

    Warns of people who are never tracked well, who keep the body of `tracker`.

    **Raises:** `InputError` if the body is not like a human, nobody is found, or nobody is tracked well.
    """
    check_at_least("estimate_people_shapes", 1, num_frames=num_frames)
    clouds = list(without_room((cloud for cloud in clouds if not cloud.missing), None))
    space = find_space(tracker, space)
    first = _track([tracker], clouds, num_people, search, up)
    if not first:
        raise InputError(
            f"estimate_people_shapes: nobody was found in {len(clouds)} frames, so there are no shapes to estimate; check the "
            "unit, the vertical axis and the body."
        )
    bodies = [_fit(tracker, own, space, num_frames) for own in first]
    if all(own.good for own in first):
        return bodies
    again = _track([replace_body(tracker, body) for body in bodies], clouds, len(bodies), search, up)
    if not any(own.good for own in (*first, *again)):
        raise InputError(
            f"estimate_people_shapes: none of {len(clouds)} frames shows anybody with the verdict 'good', so they do not show the "
            "shapes of the people; give other frames, or a body of about their height."
        )
    for number, own in enumerate(again):
        if first[number].good:
            continue
        if own.good:
            bodies[number] = _fit(tracker, own, space, num_frames)
            continue
        bodies[number] = tracker.body
        warnings.warn(
            f"none of {len(clouds)} frames shows person {number + 1} with the verdict 'good', so this person keeps the given body",
            stacklevel=2,
        )
    return bodies


def _fit(tracker: Tracker, own: _OwnFrames, space: BodyModel, num_frames: int) -> Body:
    return fit_to_some(tracker, own.clouds, own.good or own.others, space, num_frames)


def _track(
    trackers: Sequence[Tracker],
    clouds: Sequence[Cloud],
    num_people: int | None,
    search: FirstSearch,
    up: tuple[float, float, float],
) -> list[_OwnFrames]:
    """Track all people, with one tracker for all of them or one for each, and collect the frames of each person."""
    followers = [make_follower(one, up) for one in trackers]
    given = trackers[0] if len(trackers) == 1 else list(trackers)
    found: list[_OwnFrames] = []
    frames = track_people(given, clouds, num_people, search=search, up=up, planes=())
    for number, (cloud, people) in enumerate(zip(clouds, frames, strict=True)):
        _LOG.info("tracking frame %d of %d for the shapes of the people", number + 1, len(clouds))
        found += [_OwnFrames({}, {}, {}, {}) for _ in people[len(found) :]]
        present = present_people(people)
        everyone = [followers[k if len(followers) > 1 else 0] for k in range(len(people))]
        states = {k: people[k].tracked.state.estimate for k in present}
        divided = share_points(
            everyone,
            {k: one.pose for k, one in states.items()},
            {k: one.sigma for k, one in states.items()},
            cloud,
        )
        for k in present:
            own = found[k]
            own.clouds[number] = person_cloud(cloud, divided, k)
            own.add(number, people[k].pose, people[k].verdict, bool(jnp.any(people[k].contacts != APART)))
    return found
