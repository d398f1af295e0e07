"""The embedded human with a laboratory's markers on it, and how it changes with a person's traits."""

from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from ...body.people.anatomy import rest_deviations
from ...body.people.human import human_from_traits
from ...body.people.morph_targets import Traits
from ..body_shape.shape_search import MAX_TRAITS, MEAN_TRAITS, MIN_TRAITS, TRAIT_DEVIATIONS
from ..marker_sets.recognise import MarkerSet
from ..subject import FREE_DEVIATION, Subject, make_subject
from .anatomical_prior import BONE_SHARE, CHILD_BONE_SHARE, AnatomicalPrior
from .body_size import ADULT_AGE
from .rest_positions import RESOLUTION, bone_ends, placed_markers, rest_positions, stretch_fields

#: share of a trait's deviation for its finite differences
DIFFERENCE_SHARE = 0.5


class HumanTemplate(NamedTuple):
    """A person of given traits with a laboratory's markers, as the template of a calibration, and its prior."""

    subject: Subject
    prior: AnatomicalPrior
    traits: Traits


def make_human_template(
    markers: MarkerSet, traits: Traits = MEAN_TRAITS, factors: Float[np.ndarray, "4"] | None = None
) -> HumanTemplate:
    """Place the recognised markers on the human of given traits, with limbs that are longer by given `factors`."""
    chosen = placed_markers(markers)
    labels = [markers.labels[index] for index in chosen]
    names = [str(markers.names[index]) for index in chosen]
    bones = [str(markers.bones[index]) for index in chosen]
    heights, deviations = markers.heights[chosen], markers.deviations[chosen]
    offsets, centres = rest_positions(names, heights, traits)
    skeleton = human_from_traits(traits, RESOLUTION, "tracking").skeleton
    rows = np.array([skeleton.index(name) for name in bones], int)
    if factors is not None:
        fields = stretch_fields(skeleton, centres, rows, offsets)
        offsets, centres = (
            rest + np.tensordot(factors - 1.0, field, 1)
            for rest, field in zip((offsets, centres), fields, strict=True)
        )
    skeleton = eqx.tree_at(lambda s: s.centres, skeleton, jnp.asarray(centres, skeleton.centres.dtype))
    subject = make_subject(
        skeleton,
        rows,
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
    return bone_ends(subject.skeleton, centres, np.asarray(subject.bones), places)


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
    ends = [rest_positions(names, heights, traits._replace(**{field: value})) for value in (low, high)]
    places, centres = (deviation / (high - low) * (b - a) for a, b in zip(*ends, strict=True))
    # the root's own centre is arbitrary and stays
    return places - centres[0], centres - centres[0]
