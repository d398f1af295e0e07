"""What a user has to know of a person's skeleton, in sentences, the most serious first."""

from collections.abc import Sequence

import numpy as np

from ...body.people.morph_targets import Traits
from ..calibration.calibrate import Calibration
from ..marker_sets.recognise import MarkerSet
from ..motion.inverse_kinematics import describe_lost
from ..motion.unexplained_bones import describe_unexplained, unexplained_bones
from .body_size import PersonSize, body_height, is_adult
from .check_person import stands_still
from .further_markers import FurtherMarkers

#: parts of the body, and the joints of the bones that one of its markers is on
PARTS = {
    "the left arm": ("LeftArm", "LeftForeArm", "LeftHand"),
    "the right arm": ("RightArm", "RightForeArm", "RightHand"),
    "the left leg": ("LeftUpLeg", "LeftLeg", "LeftFoot"),
    "the right leg": ("RightUpLeg", "RightLeg", "RightFoot"),
    "the head": ("Head",),
    "the pelvis": ("Hips",),
    "the trunk": ("LowerBack", "Spine", "Spine1"),
}
#: standard deviation of a marker about its bone above which its label may be wrong, metres
DOUBTFUL_DEVIATION = 0.03


def describe_human(
    further: FurtherMarkers, found: Calibration, known: MarkerSet, misplaced: Sequence[str]
) -> tuple[str, ...]:
    """Describe parts without markers, joints that only anatomy places, and markers that do not fit."""
    return (
        *_parts_without_markers(found),
        *_stillness(found),
        *_misplaced_markers(misplaced),
        *_wandering_markers(found),
        *_joints_by_anatomy(found),
        *_unknown_markers(further, known),
    )


def describe_frames(found: Calibration) -> tuple[str, ...]:
    """Describe the bones that the pose of some frames does not explain, and the lost frames."""
    subject, residuals = found.subject, found.residuals
    used = np.isfinite(residuals) & (np.asarray(subject.weights) > 0) & ~found.lost[:, None]
    unexplained = unexplained_bones(subject, used, residuals)
    return (*describe_unexplained(subject, unexplained), *describe_lost(found.lost))


def describe_child(size: PersonSize, traits: Traits) -> list[str]:
    """Describe what the prior does not know of children, for a person who may be one."""
    tall = (
        f"about {size.height:.2f} ± {size.height_deviation:.2f} m tall, as children and small adults are, and is taken for"
        if size.may_be_child
        else f"about {body_height(traits):.2f} m tall, as a child is, and is taken for"
    )
    if is_adult(traits):
        return [
            f"The person is {tall} an adult. If it is a child, joints that no marker determines are less sure, and percentiles are of no use."
        ] * size.may_be_child
    return [
        f"The person is {tall} a child. The prior is one of adults, about the body of the embedded human of this size, with twice the usual "
        "spread of lengths: joints that no marker determines are less sure, and percentiles among adults are left out."
    ]


def _parts_without_markers(found: Calibration) -> list[str]:
    skeleton = found.subject.skeleton
    held = {skeleton.names[bone] for bone in np.asarray(found.subject.bones)}
    said = []
    for part, bones in PARTS.items():
        bare = [bone for bone in bones if bone not in held]
        if len(bare) == len(bones):
            said.append(f"No marker is on {part}: it stays at rest, with usual lengths for this person.")
    return said


def _stillness(found: Calibration) -> list[str]:
    if not stands_still(found.subject, found.motion):
        return []
    return [
        "The person stands still in all frames, so joints and lengths are those of people with markers at such places; give a "
        "take in which every joint rotates."
    ]


def _misplaced_markers(labels: Sequence[str]) -> list[str]:
    if not labels:
        return []
    if len(labels) == 1:
        return [
            f"The marker {labels[0]} is not at the landmark of its label; its position was found from the motion alone."
        ]
    return [
        f"{len(labels)} markers are not at the landmarks of their labels: {', '.join(labels[:12])}. Two of them may have each "
        "other's labels; their positions were found from the motion alone."
    ]


def _wandering_markers(found: Calibration) -> list[str]:
    wide = np.asarray(found.subject.deviations, float)
    order = np.argsort(-wide)
    worst = [
        f"{found.subject.labels[m]} ({1e3 * wide[m]:.0f} mm)" for m in order if wide[m] > DOUBTFUL_DEVIATION
    ]
    if not worst:
        return []
    return [f"Labels or bones of markers that move far on their bones may be wrong: {', '.join(worst[:8])}."]


def _joints_by_anatomy(found: Calibration) -> list[str]:
    names = found.subject.skeleton.names
    worst: dict[int, float] = {}
    for direction in found.imprecise_directions:
        if not direction.is_determined_by_data:
            worst[direction.joint] = max(worst.get(direction.joint, 0.0), direction.deviation)
    if not worst:
        return []
    each = ", ".join(f"{names[joint]} ({1e3 * off:.0f} mm)" for joint, off in worst.items())
    return [
        "In at least one direction the takes do not tell these joints, which stay where people have them (with "
        f"standard deviations): {each}."
    ]


def _unknown_markers(further: FurtherMarkers, known: MarkerSet) -> list[str]:
    said = []
    virtual = [label for label, is_virtual in zip(known.labels, known.virtual, strict=True) if is_virtual]
    if virtual:
        said.append(f"{len(virtual)} points are no markers and left out: {', '.join(virtual[:8])}.")
    if further.added:
        said.append(
            f"{len(further.added)} markers have unknown labels and were given to the bones that they move with: "
            f"{', '.join(further.added[:8])}."
        )
    if further.loose:
        said.append(
            f"{len(further.loose)} markers with unknown labels move with no bone and are left out: "
            f"{', '.join(further.loose[:8])}."
        )
    return said
