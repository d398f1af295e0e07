"""One frame of several people: shares of the points, and the step of each person."""

from collections.abc import Sequence
from itertools import combinations
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from ...body.pose import Pose
from ...observe.clouds import Cloud
from ..advance import Follower, advance_frame
from ..judge_frame import track_frame_jit
from ..track_frame import first_sigma, predict_pose
from .exchange import end_contact, update_contacts
from .person_frame import PersonFrame, has_points, leave, present_people, stay
from .point_shares import (
    PersonDensity,
    is_nobodys,
    person_density,
    person_weights,
    responsibilities,
    surface_distance,
)

#: points farther from the predicted surface of a person are not the person's, metres; if the person is lost, all may be
REACH = 0.5
#: if two people are nearer than this, the shares of their points are computed again with their first new poses, metres
CLOSE = 0.4
#: points of nobody are at least so far away from everyone, metres
NOBODY_DISTANCE = 0.2

_predict_pose = eqx.filter_jit(predict_pose)


class Shares(NamedTuple):
    """The points of a frame, divided between people."""

    #: of each person, zero for those who are absent
    shares: Float[Array, "K N"]
    #: of the points from each person, infinite for those who are absent, metres
    distances: Float[Array, "K N"]
    #: samples of the surfaces of the people who are present
    samples: dict[int, Float[Array, "S 3"]]


def divide_points(followers: Sequence[Follower], people: Sequence[PersonFrame], cloud: Cloud) -> Shares:
    """Divide the points of a cloud between the people who are present.

    Everyone is predicted, and the points are divided by the densities of all people. Where people are close to each other,
    this is done a second time with poses that are tracked with these shares, instead of the predicted ones.
    """
    present = present_people(people)
    states = {k: people[k].tracked.state for k in present}
    poses = {k: _predict_pose(followers[k].tracker, states[k]) for k in present}
    sigmas = {k: first_sigma(followers[k].tracker, states[k]) for k in present}
    divided = share_points(followers, poses, sigmas, cloud)
    close = {k for pair, gap in pair_distances(divided).items() if gap < CLOSE for k in pair}
    if not close:
        return divided
    for k in close:
        own = person_cloud(cloud, divided, k, _reach(people[k]))
        if float(jnp.sum(own.weights)) > 0:
            state, _ = track_frame_jit(followers[k].tracker, states[k], own)
            poses[k], sigmas[k] = state.estimate.pose, state.estimate.sigma
    return share_points(followers, poses, sigmas, cloud)


def advance_people(
    followers: Sequence[Follower],
    people: Sequence[PersonFrame],
    cloud: Cloud,
    divided: Shares,
    number: int,
    excluded: Bool[np.ndarray, "N"] | None = None,
) -> list[PersonFrame]:
    """Track all people who are present in one cloud, each with the own share of the points (`person_weights`).

    Each is judged, and searched for if necessary, with the other people as occluders. Where two people part, an exchange is
    tested for.

    **Arguments:** `excluded`, points of somebody who comes in.
    """
    people = [one if one.present else leave(one, 0.0) for one in people]
    free = cloud
    if excluded is not None and excluded.any():
        free = eqx.tree_at(lambda c: c.weights, cloud, jnp.where(jnp.asarray(excluded), 0.0, cloud.weights))
    clouds = {}
    for k in present_people(people):
        size = person_size(cloud, divided, k)
        if not has_points(people[k], size):
            people[k] = leave(people[k], size)
            continue
        clouds[k] = person_cloud(free, divided, k, _reach(people[k]))
        hiding = occluders(followers[k], divided, k, len(people))
        tracked = advance_frame(followers[k], people[k].tracked, clouds[k], number, occluders=hiding)
        people[k] = stay(people[k], tracked, size)
    people, ended = update_contacts(people, pair_distances(divided))
    for pair in ended:
        people = end_contact(followers, people, clouds, pair)
    return people


def person_size(cloud: Cloud, divided: Shares, person: int) -> float:
    """Compute the weight of the points of a person."""
    return float(jnp.sum(cloud.weights * divided.shares[person]))


def free_points(cloud: Cloud, divided: Shares) -> Bool[np.ndarray, "N"]:
    """Find the points of nobody."""
    return np.asarray(is_nobodys(cloud.weights, divided.shares, divided.distances, NOBODY_DISTANCE))


def share_points(
    followers: Sequence[Follower],
    poses: dict[int, Pose],
    sigmas: dict[int, Float[Array, ""]],
    cloud: Cloud,
) -> Shares:
    """Divide the points of a cloud between posed people, by their number among all."""
    nowhere = jnp.full_like(cloud.weights, jnp.inf)
    densities, distances, samples = [-nowhere] * len(followers), [nowhere] * len(followers), {}
    for k, pose in poses.items():
        found: PersonDensity = person_density(
            followers[k].tracker, followers[k].surface, pose, sigmas[k], cloud
        )
        densities[k], distances[k], samples[k] = found.log_density, found.distances, found.samples
    return Shares(responsibilities(jnp.stack(densities)), jnp.stack(distances), samples)


def person_cloud(cloud: Cloud, divided: Shares, person: int, reach: float = REACH) -> Cloud:
    """Weight the points of a cloud for one person."""
    weights = person_weights(
        cloud.weights, divided.shares, divided.distances[person], person, jnp.asarray(reach, jnp.float32)
    )
    return eqx.tree_at(lambda c: c.weights, cloud, weights)


def pair_distances(divided: Shares) -> dict[tuple[int, int], float]:
    """Compute the distance of the surfaces of each pair of people, metres."""
    return {
        pair: float(surface_distance(*(divided.samples[k] for k in pair)))
        for pair in combinations(sorted(divided.samples), 2)
    }


def occluders(
    follower: Follower, divided: Shares, person: int, num_people: int
) -> Float[Array, "O 4"] | None:
    """Return the samples of all other people as `gather_evidence` takes them; None for a single person.

    Their number is that of all other people, absent ones too, so that functions compile once.
    """
    none = no_occluders(follower, num_people)
    others = [np.asarray(samples) for k, samples in divided.samples.items() if k != person]
    if none is None or not others:
        return none
    points = np.pad(np.concatenate(others), ((0, 0), (0, 1)), constant_values=1.0)
    return jnp.asarray(np.pad(points, ((0, len(none) - len(points)), (0, 0))), none.dtype)


def no_occluders(follower: Follower, num_people: int) -> Float[Array, "O 4"] | None:
    """Return occluders that hide nothing, of the shape of those of `num_people`; None for a single person."""
    areas = follower.surface.areas
    return None if num_people == 1 else jnp.zeros(((num_people - 1) * len(areas), 4), areas.dtype)


def _reach(person: PersonFrame) -> float:
    return np.inf if person.tracked.lost else REACH
