"""The embedded human with a laboratory's markers on it, and how it changes with a person's traits."""

from collections.abc import Sequence
from itertools import combinations
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from ...body.people.anatomy import rest_deviations
from ...body.people.human import human, human_from_traits, shape_from_traits
from ...body.people.morph_targets import Traits
from ...body.skeleton import Skeleton
from ...geometry.attachment import Attachment, attached_positions
from ..body_shape.shape_search import MAX_TRAITS, MEAN_TRAITS, MIN_TRAITS, TRAIT_DEVIATIONS
from ..marker_sets.joints_by_landmarks import joints_by_landmarks
from ..marker_sets.landmarks import joint_landmarks, landmark_attachment
from ..marker_sets.recognise import MarkerSet
from ..subject import FREE_DEVIATION, Subject, make_subject
from .anatomical_prior import BONE_SHARE, CHILD_BONE_SHARE, AnatomicalPrior

#: resolution of the surface that markers are placed on
RESOLUTION = "low"
#: least distance of markers that show the size of a person, metres, and its least change with a standard deviation of stature; share of the
#: distance of a marker from its joint by which its distance from one at the other end of the bone varies
MIN_SIZE_DISTANCE, MIN_SLOPE, TURNING_SHARE = 0.03, 0.002, 0.5
#: the number of the trait
STATURE = Traits._fields.index("stature")
#: share of a trait's deviation for its finite differences
DIFFERENCE_SHARE = 0.5
#: height below which a person may be a child, metres; ages of children that are tried, and age from which people are adults, years
CHILD_HEIGHT, CHILD_AGES, ADULT_AGE = 1.5, (10.0, 12.0, 14.0, 17.0), 20.0


class HumanTemplate(NamedTuple):
    """A person of given traits with a laboratory's markers, as the template of a calibration, and its prior."""

    subject: Subject
    prior: AnatomicalPrior
    traits: Traits


def placed_markers(markers: MarkerSet) -> Int[np.ndarray, "N"]:
    """List the markers with a known landmark that are no virtual points."""
    known = [name is not None for name in markers.names]
    return np.flatnonzero(np.array(known, bool) & ~markers.virtual)


def make_human_template(markers: MarkerSet, traits: Traits = MEAN_TRAITS) -> HumanTemplate:
    """Place the recognised markers on the human of given traits."""
    chosen = placed_markers(markers)
    labels = [markers.labels[index] for index in chosen]
    names = [str(markers.names[index]) for index in chosen]
    bones = [str(markers.bones[index]) for index in chosen]
    heights, deviations = markers.heights[chosen], markers.deviations[chosen]
    offsets, centres = _rest_positions(names, heights, traits)
    skeleton = human_from_traits(traits, RESOLUTION, "tracking").skeleton
    skeleton = eqx.tree_at(lambda s: s.centres, skeleton, jnp.asarray(centres, skeleton.centres.dtype))
    subject = make_subject(
        skeleton,
        [skeleton.index(name) for name in bones],
        offsets,
        labels,
        deviations=deviations,
        posture=np.minimum(rest_deviations(skeleton), FREE_DEVIATION),
    )
    modes = [_trait_mode(names, heights, traits, number) for number in range(len(traits))]
    by_marker, by_centre = zip(*modes, strict=True)
    anchors = nearest_joints(subject)
    share = BONE_SHARE if traits.age >= ADULT_AGE else CHILD_BONE_SHARE
    prior = AnatomicalPrior(np.array(by_centre), np.array(by_marker), deviations, anchors, share)
    return HumanTemplate(subject, prior, traits)


def nearest_joints(subject: Subject) -> Int[np.ndarray, "M"]:
    """Find the joint nearest to each marker at rest, of the joints at both ends of its bone."""
    centres, places = (np.asarray(x, float) for x in (subject.skeleton.centres, subject.offsets))
    return _bone_ends(subject.skeleton, centres, np.asarray(subject.bones), places)


def _moving_children(skeleton: Skeleton, bone: int) -> list[int]:
    """List the joints at the ends of a bone; fixed joints are parts of it."""
    found = []
    for joint, parent in enumerate(skeleton.parents):
        if parent == bone:
            found += _moving_children(skeleton, joint) if skeleton.kinds[joint] == "fixed" else [joint]
    return found


def person_of_size(markers: MarkerSet, distances: Float[np.ndarray, "M M"]) -> Traits:
    """Find the person at whose stature the markers of each bone are as far apart as observed, all other traits at their means.

    A small person is a child: of the ages at which the human has its proportions, that with the most usual stature.
    `distances` between markers, metres, NaN where they are never visible together.
    """
    adult = _person_of_age(markers, distances, MEAN_TRAITS.age)
    if body_height(adult) >= CHILD_HEIGHT:
        return adult
    children = [_person_of_age(markers, distances, age) for age in CHILD_AGES]
    return min(children, key=lambda one: abs(one.stature - MEAN_TRAITS.stature))


def body_height(traits: Traits) -> float:
    """Compute the height of the human with these traits, metres."""
    return float(np.ptp(np.asarray(shape_from_traits(traits, RESOLUTION)[0], float)[:, 1]))


def is_adult(traits: Traits) -> bool:
    """Test if a person is as old and as tall as adults are."""
    return traits.age >= ADULT_AGE and body_height(traits) >= CHILD_HEIGHT


def _person_of_age(markers: MarkerSet, distances: Float[np.ndarray, "M M"], age: float) -> Traits:
    """Find the stature of a person of an age, from the distances between markers of one bone, and those at both of its ends.

    The sum of absolute errors over their deviations is least, as a marker on a wand or with a wrong label is far off.
    """
    mean_person = MEAN_TRAITS._replace(age=age)
    chosen = placed_markers(markers)
    names = [str(markers.names[index]) for index in chosen]
    heights, seen = markers.heights[chosen], distances[np.ix_(chosen, chosen)]
    offsets, centres = _rest_positions(names, heights, mean_person)
    by_trait = [_trait_mode(names, heights, mean_person, number)[0] for number in range(len(mean_person))]
    modes, others = by_trait[STATURE], np.array([*by_trait[:STATURE], *by_trait[STATURE + 1 :]])
    skeleton = human_from_traits(mean_person, RESOLUTION, "tracking").skeleton
    bones = np.array([skeleton.index(str(markers.bones[index])) for index in chosen], int)
    ends = _bone_ends(skeleton, centres, bones, offsets)
    # a marker turns about the joint that it is next to
    arms = TURNING_SHARE * np.linalg.norm(offsets - centres[ends], axis=1)
    variance = markers.deviations[chosen] ** 2
    tall, weights = [0.0], [1.0]
    for a, b in combinations(range(len(chosen)), 2):
        across = bones[a] != bones[b]
        if across and not _are_ends_of_bone(skeleton, int(ends[a]), int(ends[b])):
            continue
        away = offsets[a] - offsets[b]
        length = np.linalg.norm(away)
        if not np.isfinite(seen[a, b]) or length < MIN_SIZE_DISTANCE:
            continue
        slope = away @ (modes[a] - modes[b]) / length
        # people of equal stature differ, such as in the width of the pelvis
        differ = np.sum(((others[:, a] - others[:, b]) @ away / length) ** 2) + (BONE_SHARE * length) ** 2
        spread = np.sqrt(variance[a] + variance[b] + differ + across * (arms[a] ** 2 + arms[b] ** 2))
        if abs(slope) > MIN_SLOPE:
            tall.append((seen[a, b] - length) / slope)
            weights.append(abs(slope) / spread)
    stature = MEAN_TRAITS.stature + TRAIT_DEVIATIONS.stature * weighted_median(
        np.array(tall), np.array(weights)
    )
    return mean_person._replace(stature=float(np.clip(stature, MIN_TRAITS.stature, MAX_TRAITS.stature)))


def weighted_median(values: Float[np.ndarray, "N"], weights: Float[np.ndarray, "N"]) -> float:
    """Compute the value from which the weighted sum of absolute differences is least."""
    order = np.argsort(values)
    total = np.cumsum(weights[order])
    return float(values[order][np.searchsorted(total, 0.5 * total[-1])])


def _bone_ends(
    skeleton: Skeleton,
    centres: Float[np.ndarray, "J 3"],
    bones: Int[np.ndarray, "M"],
    places: Float[np.ndarray, "M 3"],
) -> Int[np.ndarray, "M"]:
    """Find the joint nearest to each marker at rest, of the joints at both ends of its bone."""
    nearest = []
    for bone, place in zip(bones.tolist(), places, strict=True):
        ends = [bone, *_moving_children(skeleton, bone)]
        nearest.append(ends[int(np.argmin(np.linalg.norm(centres[ends] - place, axis=1)))])
    return np.array(nearest, int)


def _are_ends_of_bone(skeleton: Skeleton, one: int, other: int) -> bool:
    """Test if one joint is at the end of the bone that begins at the other."""
    return other in _moving_children(skeleton, one) or one in _moving_children(skeleton, other)


def _trait_mode(
    names: Sequence[str], heights: Float[np.ndarray, "M"], traits: Traits, number: int
) -> tuple[Float[np.ndarray, "M 3"], Float[np.ndarray, "J 3"]]:
    """Compute how markers and joints move, metres, with a standard deviation of one trait."""
    deviation = TRAIT_DEVIATIONS[number]
    low, high = (
        float(np.clip(traits[number] + step * deviation, MIN_TRAITS[number], MAX_TRAITS[number]))
        for step in (-DIFFERENCE_SHARE, DIFFERENCE_SHARE)
    )
    field = Traits._fields[number]
    ends = [_rest_positions(names, heights, traits._replace(**{field: value})) for value in (low, high)]
    places, centres = (deviation / (high - low) * (b - a) for a, b in zip(*ends, strict=True))
    # the root's own centre is arbitrary and stays
    return places - centres[0], centres - centres[0]


def _rest_positions(
    names: Sequence[str], heights: Float[np.ndarray, "M"], traits: Traits
) -> tuple[Float[np.ndarray, "M 3"], Float[np.ndarray, "J 3"]]:
    """Compute the rest positions of markers on landmarks, and of the joints, of a person, metres."""
    vertices, ends = shape_from_traits(traits, RESOLUTION)
    centres = joints_by_landmarks(vertices, ends[:, 0], RESOLUTION)
    every, hold = landmark_attachment(RESOLUTION)
    places, on_skin = np.zeros((len(names), 3)), [k for k, name in enumerate(names) if name in every]
    rows = [every.index(names[k]) for k in on_skin]
    own = Attachment(hold.corners[rows], hold.barycentric[rows], heights[on_skin])
    places[on_skin] = np.asarray(attached_positions(own, vertices), float)
    joints = human(resolution=RESOLUTION).skeleton.names
    for k, name in enumerate(names):
        if name in joint_landmarks():
            places[k] = centres[joints.index(joint_landmarks()[name].joint)]
    return places, centres
