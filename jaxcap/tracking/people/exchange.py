"""Identities of people who were near each other: contacts, and the test of an exchange."""

from collections.abc import Sequence
from itertools import combinations
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ...body.body import Body
from ...body.pose import Pose
from ...observe.clouds import Cloud
from ..advance import Follower
from ..expectation_maximisation.pose_log_density import pose_log_density
from ..judge_frame import TrackedFrame, track_first_frame
from .person_frame import APART, CORRECTED, NEAR, UNDECIDED, UNSURE, PersonFrame

#: two people are near each other if their surfaces are at most so far away from each other, until they are farther than
#: the second distance, metres
NEAR_DISTANCE, APART_DISTANCE = 0.3, 0.5
#: least difference of the mean log-posterior of a point, summed over both people, that decides an exchange
MIN_GAIN = 0.1
#: standard deviation at which a person is tracked at the pose of another one, metres
EXCHANGE_SIGMA = 0.06


class Exchange(NamedTuple):
    """Two people with exchanged poses."""

    #: log-posterior of both people with exchanged poses minus that with their own ones, per point; zero for equal bodies
    gain: float
    #: the frames with exchanged poses; None for equal bodies
    frames: tuple[TrackedFrame, TrackedFrame] | None


def update_contacts(
    people: Sequence[PersonFrame], distances: dict[tuple[int, int], float]
) -> tuple[list[PersonFrame], list[tuple[int, int]]]:
    """Update who is near whom; return the people, and the pairs whose contact has ended.

    **Arguments:** `distances` of the surfaces of the pairs that are present, metres.
    """
    contacts = np.stack([np.array(person.contacts, float) for person in people])
    ended = []
    for pair in combinations(range(len(people)), 2):
        i, j = pair
        before, distance = contacts[i, j], distances.get(pair, np.inf)
        both_seen = people[i].seen_well and people[j].seen_well
        if before == APART and distance > NEAR_DISTANCE:
            continue
        if before != APART and both_seen and distance > APART_DISTANCE:
            ended.append(pair)
            continue
        contacts[i, j] = contacts[j, i] = max(before, NEAR if both_seen else UNSURE)
    return [with_contacts(person, row) for person, row in zip(people, contacts, strict=True)], ended


def with_contacts(person: PersonFrame, contacts: np.ndarray) -> PersonFrame:
    """Replace the contacts of a person."""
    return eqx.tree_at(lambda p: p.contacts, person, jnp.asarray(contacts, person.contacts.dtype))


def end_contact(
    followers: Sequence[Follower],
    people: Sequence[PersonFrame],
    clouds: dict[int, Cloud],
    pair: tuple[int, int],
    sigma: float = EXCHANGE_SIGMA,
) -> list[PersonFrame]:
    """Decide if two people whose contact has ended were exchanged, and correct it.

    Each body is fitted to the points of the other person. If both then explain the points better, they are exchanged.
    If neither is better, and one of them was not seen well during the contact, an exchange is possible, and both get a
    reason.
    """
    people, (i, j) = list(people), pair
    found = try_exchange(followers, people, clouds, pair, sigma)
    code = 0.0
    if found.frames is not None and found.gain > MIN_GAIN:
        code = CORRECTED
        sizes = people[i].num_points, people[j].num_points
        for person, tracked, size in zip(pair, found.frames, reversed(sizes), strict=True):
            people[person] = eqx.tree_at(lambda p: (p.tracked, p.num_points), people[person], (tracked, size))
    elif people[i].contacts[j] == UNSURE and abs(found.gain) <= MIN_GAIN:
        code = UNDECIDED
    for person, other in (pair, pair[::-1]):
        old = people[person]
        people[person] = eqx.tree_at(
            lambda p: (p.contacts, p.exchanges),
            old,
            (old.contacts.at[other].set(APART), old.exchanges.at[other].set(code)),
        )
    return people


def try_exchange(
    followers: Sequence[Follower],
    people: Sequence[PersonFrame],
    clouds: dict[int, Cloud],
    pair: tuple[int, int],
    sigma: float = EXCHANGE_SIGMA,
) -> Exchange:
    """Fit each of two people to the points of the other one, and compare.

    The gain is minus infinity for bodies with other joints: they would not have been exchanged.
    """
    i, j = pair
    one, other = followers[i].tracker.body, followers[j].tracker.body
    if one.skeleton.names != other.skeleton.names or one.skeleton.kinds != other.skeleton.kinds:
        return Exchange(-np.inf, None)
    if is_same_body(one, other):
        return Exchange(0.0, None)
    gain, frames = 0.0, []
    for person, source in (pair, pair[::-1]):
        tracker, surface = followers[person].tracker, followers[person].surface
        cloud, start = clouds[source], people[source].pose
        tracked = track_first_frame(tracker, surface, cloud, start, sigma)
        gain += _density(followers[person], tracked.pose, cloud)
        gain -= _density(followers[person], people[person].pose, clouds[person])
        old = people[person].tracked
        # levels of faults and searches are those of the person
        frames.append(eqx.tree_at(lambda f: (f.baseline, f.searches), tracked, (old.baseline, old.searches)))
    return Exchange(gain if np.isfinite(gain) else -np.inf, (frames[0], frames[1]))


def _density(follower: Follower, pose: Pose, cloud: Cloud) -> float:
    return float(pose_log_density(follower.tracker, pose, cloud))


def is_same_body(one: Body, other: Body) -> bool:
    """Test if two bodies have equal shapes, so that nobody can distinguish them in a cloud."""
    if one is other:
        return True
    leaves = zip(jax.tree.leaves(one), jax.tree.leaves(other), strict=False)
    return jax.tree.structure(one) == jax.tree.structure(other) and all(
        np.shape(a) == np.shape(b) and np.array_equal(a, b) for a, b in leaves
    )
