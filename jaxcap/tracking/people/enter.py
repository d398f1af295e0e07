"""People who come into the scene: groups of points that nobody explains become people."""

from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.optimize import linear_sum_assignment

from ...body.body import pose_body
from ...body.pose import Pose
from ...observe.clouds import Cloud
from ..advance import FirstSearch, Follower, find_first_frame
from ..expectation_maximisation.pose_log_density import pose_log_density
from ..judge_frame import TrackedFrame, choose_better
from ..search.starts import rotated_starts
from .exchange import is_same_body
from .groups import MIN_SIZE, assign_to_groups, find_groups
from .person_frame import UNDECIDED, PersonFrame, enter, present_people
from .scene import Shares, free_points, no_occluders, person_size

#: a person returns within this distance of the last position, metres; farther away it may be somebody else
RETURN_DISTANCE = 1.5
#: points nearer to somebody who is lost may be this person's, metres
LOST_DISTANCE = 1.0
#: least size of somebody who comes in, as a share of the height, and least share of the usual number of points
MIN_NEW_SIZE, MIN_NEW_POINTS = 0.55, 0.25
#: least share of the usual number of points from which a hidden person is tracked again at the last position, and its
#: distance from there, metres
MIN_RETURN_POINTS, HIDDEN_DISTANCE = 0.2, 0.4
#: standard deviation at which a person is tracked at a pose that was known before, metres
RETURN_SIGMA = 0.06

_pose_body = eqx.filter_jit(pose_body)


class Newcomer(NamedTuple):
    """A group of points that may be a person."""

    #: with weights of the group's points only
    cloud: Cloud
    #: median of its points, metres
    middle: Float[np.ndarray, "3"]
    num_points: float


def enter_people(
    followers: Sequence[Follower],
    people: Sequence[PersonFrame],
    newcomers: Sequence[Newcomer],
    number: int,
    *,
    search: FirstSearch = "auto",
    sigma: float = 0.1,
) -> list[PersonFrame]:
    """Match newcomers with absent people, and start to track them.

    Somebody who was seen before returns near the last position. If the bodies differ, the groups are given to the people
    who explain them best. If an equal person could have come in as well, both get a reason.
    """
    people = list(people)
    absent = [k for k, one in enumerate(people) if not one.present and one.tracked.searches.wait <= 0]
    if not absent or not newcomers:
        return people
    alike = all(is_same_body(followers[absent[0]].tracker.body, followers[k].tracker.body) for k in absent)
    if alike:
        pairs = _by_position(followers, people, absent, newcomers)
        found = {
            k: start_person(followers[k], people[k], newcomers[g], number, search, sigma) for g, k in pairs
        }
    else:
        found, pairs = _by_fit(followers, people, absent, newcomers, number, search, sigma)
    for g, k in pairs:
        if found[k].lost:
            # no person: the next trial waits
            waiting = people[k].tracked.searches.extend()
            people[k] = eqx.tree_at(lambda p: p.tracked.searches, people[k], waiting)
            continue
        others = [j for j in absent if alike and j != k and people[j].seen and people[k].seen]
        far = people[k].seen and _distance(followers[k], people[k], newcomers[g].middle) > RETURN_DISTANCE
        people[k] = enter(people[k], found[k], newcomers[g].num_points)
        for j in others if far else ():
            people[k], people[j] = mark_undecided(people[k], j), mark_undecided(people[j], k)
    return people


def find_newcomers(
    followers: Sequence[Follower],
    people: Sequence[PersonFrame],
    cloud: Cloud,
    divided: Shares,
) -> list[Newcomer]:
    """Find the groups of points of nobody that may be people, largest first.

    A group near the last position of somebody hidden may be smaller than a person. A group near somebody who is lost or has
    hardly any points is no newcomer: it may be that person.
    """
    follower, usual = followers[0], max(person.usual_points for person in people)
    rows = np.flatnonzero(free_points(cloud, divided))
    if len(rows) < max(MIN_RETURN_POINTS * usual, 1.0):
        return []
    points = np.asarray(cloud.points, float)[rows]
    height = float(follower.surface.size)
    up = np.asarray(follower.up, float) / np.linalg.norm(follower.up)
    groups = find_groups(points, height, up, MIN_SIZE)
    if any(person.seen for person in people):
        groups = [
            g for g in groups if _is_new(points[g], height, usual) or _is_return(points[g], people, followers)
        ]
    lost = [
        k
        for k in present_people(people)
        if people[k].lost or person_size(cloud, divided, k) < MIN_RETURN_POINTS * people[k].usual_points
    ]
    groups = [
        g
        for g in groups
        if all(_distance(followers[k], people[k], np.median(points[g], 0)) > LOST_DISTANCE for k in lost)
    ]
    if not groups:
        return []
    return [
        make_newcomer(cloud, rows[mask], points[group])
        for mask, group in zip(assign_to_groups(points, groups), groups, strict=True)
    ]


def make_newcomer(cloud: Cloud, rows: Int[np.ndarray, "M"], points: Float[np.ndarray, "G 3"]) -> Newcomer:
    """Weight a cloud for some rows, of a group with given points."""
    weights = np.zeros(len(cloud.weights), np.asarray(cloud.weights).dtype)
    weights[rows] = np.asarray(cloud.weights)[rows]
    own = eqx.tree_at(lambda c: c.weights, cloud, jnp.asarray(weights))
    return Newcomer(own, np.median(points, axis=0), float(weights.sum()))


def points_of(newcomers: Sequence[Newcomer]) -> Bool[np.ndarray, "N"] | None:
    """Mark the points of all newcomers; None if there are none."""
    if not newcomers:
        return None
    return np.any([np.asarray(one.cloud.weights) > 0 for one in newcomers], axis=0)


def start_person(
    follower: Follower,
    person: PersonFrame,
    newcomer: Newcomer,
    number: int,
    search: FirstSearch = "auto",
    sigma: float = 0.1,
) -> TrackedFrame:
    """Find the pose of somebody who comes in: at first the last known one moved to the points, then by a search.

    The pose of somebody who has not been seen before is always searched for, unless `search` is false.
    """
    up = jnp.asarray(follower.up, newcomer.cloud.points.dtype)
    starts = rotated_starts(follower.tracker, newcomer.cloud, person.tracked.trusted, 1, up)
    pose = Pose(starts.translations[0], starts.rotations[0], person.tracked.trusted.scale)
    if search is not False and not person.seen:
        search = True
    hiding = no_occluders(follower, len(person.contacts))
    return find_first_frame(
        follower,
        newcomer.cloud,
        pose,
        number,
        search=search,
        sigma=RETURN_SIGMA if person.seen else sigma,
        occluders=hiding,
    )


def mark_undecided(person: PersonFrame, other: int) -> PersonFrame:
    """Mark that a person may have been exchanged with another one."""
    return eqx.tree_at(lambda p: p.exchanges, person, person.exchanges.at[other].set(UNDECIDED))


def _by_position(
    followers: Sequence[Follower],
    people: Sequence[PersonFrame],
    absent: Sequence[int],
    newcomers: Sequence[Newcomer],
) -> list[tuple[int, int]]:
    """Pair newcomers with absent people of equal bodies: the nearest ones, then those not seen before, then others."""
    left, pairs = list(absent), []
    for g, newcomer in enumerate(newcomers):
        if not left:
            break
        away = {k: _distance(followers[k], people[k], newcomer.middle) for k in left if people[k].seen}
        near = [k for k in away if away[k] <= RETURN_DISTANCE]
        new = [k for k in left if not people[k].seen]
        chosen = min(near or new or away, key=lambda k: away.get(k, 0.0))
        left.remove(chosen)
        pairs.append((g, chosen))
    return pairs


def _by_fit(
    followers: Sequence[Follower],
    people: Sequence[PersonFrame],
    absent: Sequence[int],
    newcomers: Sequence[Newcomer],
    number: int,
    search: FirstSearch,
    sigma: float,
) -> tuple[dict[int, TrackedFrame], list[tuple[int, int]]]:
    """Pair newcomers with absent people of different bodies by the densities of their fits.

    The pose is searched for with one body. The others are tracked from there if they have the same joints, and
    searched for once they are chosen.
    """
    frames, scores, searched = {}, np.zeros((len(newcomers), len(absent))), set()
    for g, newcomer in enumerate(newcomers):
        pose = None
        for column, k in enumerate(absent):
            follower, known = followers[k], followers[absent[0]].tracker.body.skeleton.names
            if pose is not None and follower.tracker.body.skeleton.names == known:
                hiding = no_occluders(follower, len(people))
                frame = find_first_frame(
                    follower, newcomer.cloud, pose, number, search=False, sigma=sigma, occluders=hiding
                )
            else:
                frame = start_person(follower, people[k], newcomer, number, search, sigma)
                searched.add((g, k))
            pose = frame.pose if pose is None else pose
            frames[g, k] = frame
            scores[g, column] = float(pose_log_density(follower.tracker, frame.pose, newcomer.cloud))
    lowest = np.where(np.isfinite(scores), scores, -1e6)
    chosen = [(int(g), absent[column]) for g, column in zip(*linear_sum_assignment(-lowest), strict=True)]
    for g, k in chosen:
        if search is False or people[k].seen or (g, k) in searched:
            continue
        # a search with the wrong body may have found the back as the front
        own = start_person(followers[k], people[k], newcomers[g], number, search, sigma)
        frames[g, k] = choose_better(followers[k].tracker, newcomers[g].cloud, own, frames[g, k])
    return {k: frames[g, k] for g, k in chosen}, chosen


def _is_new(points: Float[np.ndarray, "N 3"], height: float, usual: float) -> bool:
    size = float(np.ptp(points, axis=0).max())
    return len(points) >= MIN_NEW_POINTS * usual and size >= MIN_NEW_SIZE * height


def _is_return(
    points: Float[np.ndarray, "N 3"], people: Sequence[PersonFrame], followers: Sequence[Follower]
) -> bool:
    """Test if points are enough of somebody who was hidden, at the last position."""
    middle = np.median(points, axis=0)
    return any(
        person.seen
        and not person.present
        and len(points) >= MIN_RETURN_POINTS * person.usual_points
        and _distance(follower, person, middle) <= HIDDEN_DISTANCE
        for follower, person in zip(followers, people, strict=True)
    )


def _distance(follower: Follower, person: PersonFrame, middle: Float[np.ndarray, "3"]) -> float:
    """Compute the horizontal distance of a person's last position from a point, metres."""
    vertices = np.asarray(_pose_body(follower.surface.body, person.tracked.trusted).vertices, float)
    away = np.median(vertices, axis=0) - middle
    up = np.asarray(follower.up, float) / np.linalg.norm(follower.up)
    return float(np.linalg.norm(away - (away @ up) * up))
