"""The size of a person at which a fit begins: stature and the lengths of the limbs, from distances between markers.

The logarithms of stature and of the lengths of the limbs are jointly normal, as those of adults are, with a mean for people of all sizes. Each
limb is observed by the distances between markers at both of its ends. The arms of the embedded human are shorter than those of people, its
legs are not, so that one size for the whole body would make the legs of people too long. Fits begin with the human of this stature, with arms of the observed
lengths. To begin with the observed lengths of the legs, too, was measured to be worse.
"""

from itertools import combinations
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from ...body.people.human import human_from_traits, shape_from_traits
from ...body.people.morph_targets import Traits
from ...body.skeleton import Skeleton
from ..body_shape.shape_search import MAX_TRAITS, MEAN_TRAITS, MIN_TRAITS
from ..marker_sets.recognise import MarkerSet
from .population import (
    LIMBS,
    STATURE,
    condition_normal,
    covariance_of_logarithms,
    differences_of_means,
    human_means,
)
from .rest_positions import (
    RESOLUTION,
    bone_ends,
    limb_ends,
    limb_lengths,
    placed_markers,
    rest_positions,
    stretch_fields,
)

#: share of the distance of a marker from its joint by which its distance from one at the other end of the bone varies
TURNING_SHARE = 0.5
#: joints of the sides that turn about their axis of flexion above all
HINGES = ("ForeArm", "Leg", "Foot")
#: least change of a distance, as a share of the change of the length of the limb that it shows
MIN_SLOPE = 0.5
#: limbs that are shorter in the embedded human than in people
ARMS = ("upper arm", "forearm")
#: relative deviation of the size of people of all ages
SIZE_SPREAD = 0.15
#: deviations from what the other limbs say from which on a limb's distances do not count
MAX_RATIO = 3.0
#: number of sizes at which distances are compared, one after the other
NUM_ROUNDS = 3
#: height below which nearly all people are children, of women all but 0.1 % (ANSUR II), so that a person is taken for a child, metres; ages of children that are tried, and age from which people are adults, years
CHILD_HEIGHT, CHILD_AGES, ADULT_AGE = 1.42, (10.0, 12.0, 14.0, 17.0), 20.0
#: standard deviations from that height within which it is unsure (of 90 % of normal errors)
DOUBT_RATIO = 1.645
#: number of statures at which the heights of people of an age are computed
NUM_STATURES = 9


class PersonSize(NamedTuple):
    """The size of a person."""

    #: traits of the embedded human of this stature, all others at their means
    traits: Traits
    #: lengths of the limbs of `LIMBS`, metres
    lengths: Float[np.ndarray, "4"]
    #: stature, and its standard deviation, metres
    height: float
    height_deviation: float

    @property
    def arm_factors(self) -> Float[np.ndarray, "4"]:
        """Factors of the lengths of the limbs to those of the embedded human with these traits: of the arms only, which are longer in people."""
        skeleton = human_from_traits(self.traits, RESOLUTION, "tracking").skeleton
        _, centres = rest_positions([], np.zeros(0), self.traits)
        return np.where(np.isin(list(LIMBS), ARMS), self.lengths / limb_lengths(skeleton, centres), 1.0)

    @property
    def may_be_child(self) -> bool:
        """Return true if the height is that of small adults and of children."""
        return abs(self.height - CHILD_HEIGHT) < DOUBT_RATIO * self.height_deviation


def person_of_size(markers: MarkerSet, distances: Float[np.ndarray, "M M"]) -> PersonSize:
    """Estimate the stature of a person and the lengths of the limbs from the distances between markers.

    A small person is a child: of the ages at which the human has its proportions, that with the most usual stature.
    `distances` between markers, metres, NaN where they are never visible together.
    """
    size = PersonSize(MEAN_TRAITS, np.exp(human_means()[1:]), STATURE, np.inf)
    for _ in range(NUM_ROUNDS):
        height, deviation, lengths = estimate_size(*observe_limbs(markers, distances, size))
        size = PersonSize(_traits_of_height(height, MEAN_TRAITS.age), lengths, height, deviation)
    if size.height >= CHILD_HEIGHT:
        return size
    children = [_traits_of_height(size.height, age) for age in CHILD_AGES]
    usual = min(children, key=lambda one: abs(one.stature - MEAN_TRAITS.stature))
    return size._replace(traits=usual)


def body_height(traits: Traits) -> float:
    """Compute the height of the human with these traits, metres."""
    return float(np.ptp(np.asarray(shape_from_traits(traits, RESOLUTION)[0], float)[:, 1]))


def is_adult(traits: Traits) -> bool:
    """Test if a person is as old and as tall as adults are."""
    return traits.age >= ADULT_AGE and body_height(traits) >= CHILD_HEIGHT


def observe_limbs(
    markers: MarkerSet, distances: Float[np.ndarray, "M M"], size: PersonSize
) -> tuple[Float[np.ndarray, "4"], Float[np.ndarray, "4"]]:
    """Estimate the logarithms of the lengths of the limbs, metres, and their variances; NaN where no markers show a limb.

    The distance between markers at both ends of a limb is compared with that of a person of a `size` near to the true one; the difference
    is due to the length of the limb. The result is the weighted median of all pairs, as a marker on a wand or with a wrong label is far off.
    """
    chosen = placed_markers(markers)
    names = [str(markers.names[index]) for index in chosen]
    places, centres = rest_positions(names, markers.heights[chosen], size.traits)
    skeleton = human_from_traits(size.traits, RESOLUTION, "tracking").skeleton
    bones = np.array([skeleton.index(str(markers.bones[index])) for index in chosen], int)
    ends = bone_ends(skeleton, centres, bones, places)
    fields, _ = stretch_fields(skeleton, centres, bones, places)
    own = limb_lengths(skeleton, centres)
    arms = TURNING_SHARE * _turning_arms(skeleton, ends, places - centres[ends])
    variances = markers.deviations[chosen] ** 2 + arms**2
    places = places + np.tensordot(size.lengths / own - 1.0, fields, 1)
    seen = distances[np.ix_(chosen, chosen)]
    logarithms, spreads = np.full(len(LIMBS), np.nan), np.full(len(LIMBS), np.inf)
    pairs = [pair for pair in combinations(range(len(chosen)), 2) if np.isfinite(seen[pair])]
    for limb, sides in enumerate(limb_ends(skeleton).tolist()):
        joints = [sorted(side) for side in sides]
        shown, weights = [], []
        for a, b in pairs:
            if sorted((ends[a], ends[b])) not in joints:
                continue
            away = places[a] - places[b]
            length = np.linalg.norm(away)
            # change of the distance with the length of the limb
            slope = away @ (fields[limb, a] - fields[limb, b]) / (length * own[limb])
            if slope < MIN_SLOPE:
                continue
            shown.append(size.lengths[limb] + (seen[a, b] - length) / slope)
            weights.append(slope / np.sqrt(variances[a] + variances[b]))
        if shown:
            middle = weighted_median(np.array(shown), np.array(weights))
            logarithms[limb] = np.log(max(middle, 0.5 * own[limb]))
            spreads[limb] = 1.0 / (max(weights) * np.exp(logarithms[limb]))
    return logarithms, spreads**2


def estimate_size(
    observed: Float[np.ndarray, "4"], variances: Float[np.ndarray, "4"]
) -> tuple[float, float, Float[np.ndarray, "4"]]:
    """Estimate the height, its standard deviation, and the lengths of all limbs, metres, from logarithms of observed lengths, NaN where unknown.

    A limb that is far from what the others say does not count; the farthest one first.
    """
    mean, covariance = human_means(), covariance_of_logarithms() + SIZE_SPREAD**2
    covariance += np.diag(differences_of_means() ** 2)
    values, errors = np.append(np.nan, observed), np.append(np.inf, variances)
    while np.isfinite(values).sum() > 2:
        ratios = np.zeros(len(values))
        for index in np.flatnonzero(np.isfinite(values)):
            others = np.where(np.arange(len(values)) == index, np.nan, values)
            expected, spread = condition_normal(mean, covariance, others, errors)
            ratios[index] = abs(values[index] - expected[index]) / np.sqrt(
                spread[index, index] + errors[index]
            )
        if ratios.max() < MAX_RATIO:
            break
        values[np.argmax(ratios)] = np.nan
    found, spread = condition_normal(mean, covariance, values, errors)
    height = float(np.exp(found[0]))
    return height, height * float(np.sqrt(spread[0, 0])), np.exp(found[1:])


def weighted_median(values: Float[np.ndarray, "N"], weights: Float[np.ndarray, "N"]) -> float:
    """Compute the value from which the weighted sum of absolute differences is least; the middle of two such values."""
    order = np.argsort(values)
    total = np.cumsum(weights[order])
    low, high = (int(np.searchsorted(total, 0.5 * total[-1] * (1.0 + step))) for step in (-1e-9, 1e-9))
    return float(0.5 * (values[order][low] + values[order][high]))


def _turning_arms(
    skeleton: Skeleton, joints: Int[np.ndarray, "M"], away: Float[np.ndarray, "M 3"]
) -> Float[np.ndarray, "M"]:
    """Compute how far markers are from the joints that they turn about, metres: of hinges, from the axis."""
    axes = np.asarray(skeleton.axes, float)[joints, 0]
    is_hinge = np.isin(joints, [skeleton.index(side + name) for side in ("Left", "Right") for name in HINGES])
    along = np.where(is_hinge, np.einsum("ma,ma->m", away, axes), 0.0)
    return np.linalg.norm(away - along[:, None] * axes, axis=1)


def _traits_of_height(height: float, age: float) -> Traits:
    """Find the traits of a person of an age and a height, metres, all but stature at their means."""
    mean = MEAN_TRAITS._replace(age=age)
    statures = np.linspace(MIN_TRAITS.stature, MAX_TRAITS.stature, NUM_STATURES)
    heights = [body_height(mean._replace(stature=float(one))) for one in statures]
    return mean._replace(stature=float(np.interp(height, heights, statures)))
