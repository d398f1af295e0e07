"""The embedded human with all landmarks as markers, and how often laboratories use each of them."""

import functools

import numpy as np
from jaxtyping import Float, Int

from ...body.people.human import shape_from_traits
from ...body.people.morph_targets import Traits
from ..body_shape.shape_search import MAX_TRAITS, MEAN_TRAITS, MIN_TRAITS
from ..body_shape.surface_markers import MARKER_HEIGHT
from ..human.human_template import make_human_template
from ..human.rest_positions import RESOLUTION
from ..marker_sets.landmarks import landmarks, mirror_landmark
from ..marker_sets.recognise import MarkerSet, landmark_counts
from ..subject import Subject

#: number of statures that heights are computed for
NUM_STATURES = 9


@functools.cache
def all_landmarks() -> MarkerSet:
    """List all landmarks as a marker set, with their names as labels."""
    table = landmarks()
    count = len(table)
    return MarkerSet(
        tuple(table),
        tuple(table),
        tuple(mark.bone for mark in table.values()),
        np.array([mark.deviation for mark in table.values()]),
        np.full(count, MARKER_HEIGHT),
        np.zeros(count, bool),
        (None,) * count,
        None,
    )


@functools.cache
def mirrored_landmarks() -> Int[np.ndarray, "L"]:
    """Find the same landmark of the other side for each landmark; itself in the middle."""
    names = all_landmarks().labels
    return np.array([names.index(mirror_landmark(name)) for name in names])


def landmark_costs() -> Float[np.ndarray, "L"]:
    """Compute twice the negative logarithm of how often marker sets have each landmark, zero for the most frequent."""
    counts = landmark_counts()
    frequency = np.array([counts.get(name, 0) + 0.5 for name in all_landmarks().labels])
    return -2.0 * np.log(frequency / frequency.max())


@functools.lru_cache(maxsize=4)
def landmark_subject(height: float) -> Subject:
    """Place all landmarks on a person of a height, metres."""
    statures = np.linspace(MIN_TRAITS.stature, MAX_TRAITS.stature, NUM_STATURES)
    stature = float(np.interp(height, [height_of(float(one)) for one in statures], statures))
    return make_human_template(all_landmarks(), MEAN_TRAITS._replace(stature=stature)).subject


@functools.cache
def height_of(stature: float) -> float:
    """Compute the height of a person with a stature and mean traits otherwise, metres."""
    vertices, _ = shape_from_traits(Traits(*MEAN_TRAITS)._replace(stature=stature), RESOLUTION)
    return float(np.ptp(np.asarray(vertices)[:, 1]))
