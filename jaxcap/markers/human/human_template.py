"""The embedded human with a laboratory's markers on it, and how it changes with a person's traits."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from ...body.people.human import human, human_from_traits, shape_from_traits
from ...body.people.morph_targets import Traits
from ...geometry.attachment import attached_positions
from ..body_shape.shape_search import MAX_TRAITS, MEAN_TRAITS, MIN_TRAITS, TRAIT_DEVIATIONS
from ..body_shape.surface_markers import SurfaceMarkers
from ..subject import Subject, make_subject
from .anatomical_prior import AnatomicalPrior

#: resolution of the surface that markers are placed on
RESOLUTION = "low"
#: share of a trait's deviation for its finite differences
STEP = 0.5


class HumanTemplate(NamedTuple):
    """A person of given traits with markers, as the template of a calibration, and its prior."""

    subject: Subject
    prior: AnatomicalPrior
    traits: Traits


def make_human_template(
    markers: SurfaceMarkers,
    bones: Sequence[str],
    placements: Float[np.ndarray, "M"],
    traits: Traits = MEAN_TRAITS,
) -> HumanTemplate:
    """Place markers on the human of given traits.

    **Arguments:** `markers` on its surface; `bones`, the joint of the bone that each marker moves with;
    `placements`, the standard deviation of each marker about its landmark, metres.
    """
    skeleton = human_from_traits(traits, RESOLUTION, "tracking").skeleton
    subject = make_subject(
        skeleton,
        [skeleton.index(name) for name in bones],
        _places(markers, traits)[0],
        markers.labels,
        deviations=np.maximum(placements, 1e-3),
    )
    by_centre, by_marker = [], []
    for number, deviation in enumerate(TRAIT_DEVIATIONS):
        ends = [
            float(np.clip(traits[number] + sign * STEP * deviation, MIN_TRAITS[number], MAX_TRAITS[number]))
            for sign in (-1, 1)
        ]
        low, high = (
            _places(markers, traits._replace(**{Traits._fields[number]: value})) for value in ends
        )
        share = deviation / (ends[1] - ends[0])
        # the root's own centre is arbitrary and stays
        shift = high[1][0] - low[1][0]
        by_marker.append(share * (high[0] - low[0] - shift))
        by_centre.append(share * (high[1] - low[1] - shift))
    prior = AnatomicalPrior(np.array(by_centre), np.array(by_marker), np.asarray(placements, float))
    return HumanTemplate(subject, prior, traits)


def _places(
    markers: SurfaceMarkers, traits: Traits
) -> tuple[Float[np.ndarray, "M 3"], Float[np.ndarray, "J 3"]]:
    """Compute the rest positions of the markers and of the joints of a person, metres."""
    vertices, ends = shape_from_traits(traits, RESOLUTION)
    places = np.asarray(attached_positions(markers.attachment, vertices), float)
    return places, ends[:, 0]


def human_joint_names() -> tuple[str, ...]:
    """List the joints of the human that calibrations use."""
    return human(resolution=RESOLUTION, joints="tracking").skeleton.names
