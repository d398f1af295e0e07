"""The skeleton of a person from labelled markers, with the embedded human as the template."""

from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from ...arguments import checked
from ...body.body import Body
from ...body.people.human import human_from_traits
from ...body.people.morph_targets import Traits
from ...body.pose import Motion
from ...energy.check_energies import UserTerms
from ...observe.markers import MarkerFrames
from ..body_shape.shape_search import MAX_TRAITS, MIN_TRAITS, TRAIT_DEVIATIONS
from ..calibration.calibrate import Calibration, calibrate
from ..calibration.calibration_parameters import shared_parameters
from ..calibration.frame_selection import NoFrameFits
from ..marker_sets.recognise import MarkerSet, recognise_markers
from ..segments.pair_distances import median_distances
from ..segments.swaps import correct_swaps, describe_exchanges
from ..subject import Subject
from .body_lengths import describe_lengths, segment_lengths
from .body_size import ADULT_AGE, is_adult, person_of_size
from .check_arms import check_arms
from .check_legs import check_legs
from .check_person import (
    check_articulated,
    check_explained,
    check_one_person,
    check_recognised,
    check_sides,
    unexplained_error,
)
from .describe_human import describe_child, describe_frames, describe_human
from .further_markers import attach_further_markers
from .human_template import HumanTemplate, make_human_template
from .misplaced_markers import constant_residuals, find_misplaced, place_where_seen, widen_placements
from .rest_positions import RESOLUTION
from .static_pose import append_static, static_weights, without_static

#: number of frames that tell as much as one with independent errors: the displacement of skin repeats with the pose, so that
#: a hundred frames determine the place of a joint hardly better than one
FRAMES_PER_OBSERVATION = 100.0
#: largest deviation of a marker as a multiple of that of all: a marker that is off its landmark is to move there, and not to lose
#: its weight
MAX_DEVIATION_RATIO = 3.0
#: number of calibrations until all markers that are not at their landmarks are found
MAX_CALIBRATIONS = 4
#: least number of frames that show if labels are exchanged
MIN_FRAMES_OF_EXCHANGES = 10


class HumanFit(NamedTuple):
    """A person's skeleton with the markers of a laboratory, and the motion of the takes."""

    subject: Subject
    motion: Motion
    #: distances between observed and predicted markers, metres, NaN where not visible; in the subject's order
    residuals: Float[np.ndarray, "F M"]
    #: frames with too few markers or without a pose that fits; they keep the last pose
    lost: Bool[np.ndarray, "F"]
    #: the markers that are ever visible, after exchanged labels were corrected
    markers: MarkerFrames
    #: the embedded human with the person's traits
    body: Body
    traits: Traits
    #: the landmarks that the labels name
    marker_set: MarkerSet
    calibration: Calibration
    #: messages to the user, in sentences, the most serious first
    messages: tuple[str, ...]


@checked
def fit_human(
    frames: MarkerFrames,
    *,
    static: MarkerFrames | None = None,
    marker_set: MarkerSet | None = None,
    num_frames: int = 100,
    skin: bool = True,
    terms: UserTerms = (),
) -> HumanFit:
    """Fit the embedded human's skeleton to markers with the labels of a laboratory.

    Labels name the landmarks (`recognise_markers`). People differ by their traits, by the lengths of single bones, nearly
    equal on both sides, and by how exactly their markers are placed (`AnatomicalPrior`). Postures have a prior too: the spine bends evenly, knees and elbows are nearly hinges. What the markers do not determine keeps its anatomical place.

    **Arguments:** `frames` of one person; `static`, a trial in which the person stands still, which counts as much as all
    frames together: markers that only this trial has, such as those at medial epicondyles and malleoli, are placed on their
    bones by it; `marker_set`, the landmarks of all markers, such as those of `recognise_by_geometry`, by
    default those of the labels; `num_frames` to calibrate with, as different as possible; `skin`: markers may slide
    on their bones as joints rotate; `terms`, energies of your own, as of `calibrate`.

    **Raises:** `InputError` where too few labels are known, left and right are exchanged, or no pose of a person explains
    most frames.
    """
    if static is not None:
        frames = append_static(frames, static)
    never = [label for label, seen in zip(frames.labels, _ever_seen(frames), strict=True) if not seen]
    known = recognise_markers(frames.labels) if marker_set is None else marker_set
    check_recognised(known, frames)
    check_one_person(frames)
    frames, exchanges = correct_labels(visible_markers(frames), has_static=static is not None)
    check_articulated(frames)
    known = recognise_markers(frames.labels) if marker_set is None else select_set(marker_set, frames.labels)
    distances = median_distances(np.asarray(frames.positions, float), np.asarray(frames.visible))
    size = person_of_size(known, distances)
    # arms whose lengths are estimated with wrong labels would explain these
    usual = make_human_template(known, size.traits).subject
    check_sides(usual, known, frames)
    check_legs(known, frames)
    check_arms(usual, known, frames)
    template = make_human_template(known, size.traits, size.arm_factors)
    landmarks = select_markers(frames, template.subject.labels)
    # a single frame is an observation too
    share = float(min(FRAMES_PER_OBSERVATION, num_frames, len(frames)))
    weights = None if static is None else static_weights(len(frames), num_frames)
    at_landmarks, bones = template, np.asarray(template.subject.bones)
    misplaced = np.zeros(len(bones), bool)
    for number in range(MAX_CALIBRATIONS):
        found = _calibrate(
            landmarks,
            template.subject,
            skin=skin,
            num_frames=num_frames,
            template_prior=template.prior,
            frames_per_observation=share,
            frame_weights=weights,
            max_deviation_ratio=MAX_DEVIATION_RATIO,
            terms=terms,
        )
        residuals = constant_residuals(found, landmarks)
        others = np.where(misplaced[:, None], 0.0, residuals)
        further_off = find_misplaced(others, bones, at_landmarks.prior.placements)
        misplaced |= further_off
        if not further_off.any() or number == MAX_CALIBRATIONS - 1:
            break
        placements = widen_placements(at_landmarks.prior.placements, bones, misplaced)
        template = template._replace(
            subject=place_where_seen(at_landmarks.subject, found.subject, residuals, misplaced),
            prior=eqx.tree_at(lambda p: p.placements, at_landmarks.prior, placements),
        )
    if static is not None:
        found, frames = without_static(found), frames[slice(0, -1)]
    check_explained(found.lost, frames)
    traits, subject = complete_skeleton(template, found)
    further = attach_further_markers(subject, found.motion, found.lost, frames, known)
    body = human_from_traits(traits, RESOLUTION, "tracking")
    return HumanFit(
        further.subject,
        found.motion,
        further.residuals(found.residuals),
        found.lost,
        frames,
        body,
        traits,
        known,
        found,
        (
            *describe_frames(found),
            *describe_child(size, traits),
            *(describe_lengths(segment_lengths(found, subject.skeleton)) if is_adult(traits) else []),
            *describe_human(
                further, found, known, [template.subject.labels[m] for m in np.flatnonzero(misplaced)]
            ),
            *exchanges,
            *([f"{len(never)} markers are never visible: {', '.join(never[:10])}."] if never else []),
        ),
    )


def _calibrate(frames: MarkerFrames, subject: Subject, **options) -> Calibration:
    """Calibrate a person. Raises `InputError` if no pose of the person explains a frame."""
    try:
        return calibrate(frames, subject, **options)
    except NoFrameFits:
        raise unexplained_error(1.0, frames.labels) from None


def complete_skeleton(template: HumanTemplate, found: Calibration) -> tuple[Traits, Subject]:
    """Estimate the traits, and place the joints that no marker determines as in a person with these traits."""
    shared = np.asarray(shared_parameters(template.subject, found.subject, found.joints), float)
    amounts = template.prior.estimate_traits(template.subject, found.joints, shared)
    values = np.array(template.traits) + amounts * np.array(TRAIT_DEVIATIONS)
    is_adult = template.traits.age >= ADULT_AGE
    # adults differ otherwise than children do
    lowest = MIN_TRAITS._replace(age=ADULT_AGE) if is_adult else MIN_TRAITS
    highest = MAX_TRAITS if is_adult else MAX_TRAITS._replace(age=ADULT_AGE)
    traits = Traits(*(float(value) for value in np.clip(values, lowest, highest)))
    skeleton = found.subject.skeleton
    centres = np.asarray(skeleton.centres, float).copy()
    before = np.asarray(template.subject.skeleton.centres, float)
    usual = before + np.tensordot(amounts, template.prior.centre_modes, 1)
    below = {joint for joint in range(skeleton.num_joints) if _is_unseen(found, joint)}
    for joint, parent in enumerate(skeleton.parents):
        if joint in below and parent >= 0:
            centres[joint] = centres[parent] + usual[joint] - usual[parent]
    return traits, eqx.tree_at(
        lambda s: s.skeleton.centres, found.subject, jnp.asarray(centres, skeleton.centres.dtype)
    )


def _is_unseen(found: Calibration, joint: int) -> bool:
    """Return true if neither the joint nor any below it carries a marker, and its centre was not solved."""
    skeleton = found.subject.skeleton
    carried = skeleton.descendants[joint, np.asarray(found.subject.bones)].any()
    return joint not in found.joints and not carried


def select_set(markers: MarkerSet, labels: Sequence[str]) -> MarkerSet:
    """Select the entries of a marker set by the labels, in their order."""
    rows = [markers.labels.index(label) for label in labels]
    return markers._replace(
        labels=tuple(labels),
        names=tuple(markers.names[row] for row in rows),
        bones=tuple(markers.bones[row] for row in rows),
        deviations=markers.deviations[rows],
        heights=markers.heights[rows],
        virtual=markers.virtual[rows],
        sets=tuple(markers.sets[row] for row in rows),
    )


def visible_markers(frames: MarkerFrames) -> MarkerFrames:
    """Select the markers that are ever visible."""
    seen = _ever_seen(frames)
    return select_markers(frames, [label for label, some in zip(frames.labels, seen, strict=True) if some])


def correct_labels(frames: MarkerFrames, *, has_static: bool = False) -> tuple[MarkerFrames, tuple[str, ...]]:
    """Correct exchanged labels, with messages on these; with `has_static` the last frame is that of a static pose."""
    if len(frames) < MIN_FRAMES_OF_EXCHANGES:
        return frames, ()
    places, seen = np.asarray(frames.positions, float), np.asarray(frames.visible)
    mended = correct_swaps(places, seen, frames.labels)
    if not mended.messages:
        return frames, ()
    messages = list(mended.messages)
    if has_static:
        messages = list(describe_exchanges(mended.source[:-1], mended.seen[:-1], frames.labels))
        wrong = mended.seen[-1] & (mended.source[-1] != np.arange(len(frames.labels)))
        if wrong.any():
            names = ", ".join(frames.labels[index] for index in np.flatnonzero(wrong))
            messages.append(f"In the static trial labels are on other markers ({names}), which is corrected.")
    positions = mended.positions.astype(np.asarray(frames.positions).dtype)
    return MarkerFrames(positions, mended.seen, frames.labels, frames.rate), tuple(messages)


def _ever_seen(frames: MarkerFrames) -> Bool[np.ndarray, "M"]:
    return np.asarray(np.any(np.asarray(frames.visible), axis=0))


def select_markers(frames: MarkerFrames, labels: Sequence[str]) -> MarkerFrames:
    """Select markers by their labels."""
    columns = [frames.labels.index(label) for label in labels]
    positions, visible = np.asarray(frames.positions)[:, columns], np.asarray(frames.visible)[:, columns]
    return MarkerFrames(positions, visible, tuple(labels), frames.rate)
