"""Sentences about labels that were found, contradicted, or could not be found."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool

from ...observe.markers import MarkerFrames
from ..motion.inverse_kinematics import MIN_MARKERS
from ..segments.gaps import list_runs
from ..subject import Subject
from .first_pose import GATES, PointPose

#: number of runs of frames, and of names, in a sentence
MAX_LISTED = 8
#: share of visible frames in which a given label has to be contradicted to be reported
MIN_CONTRADICTED = 0.02


class TrackLabel(NamedTuple):
    """Frames `begin` to `end`, exclusive, of a marker in the input, and the label found for them."""

    name: str
    begin: int
    end: int
    #: None: no marker of the subject
    label: str | None


def refuse_subject(subject: Subject) -> str:
    """Describe why a subject cannot label points; empty if it can."""
    bones = np.asarray(subject.bones)[np.asarray(subject.weights) > 0]
    most = int(np.bincount(bones, minlength=1).max()) if len(bones) else 0
    if most >= 3:
        return ""
    return (
        f"The subject has at most {most} markers on one bone, but a pose is found from the distances between three "
        "markers of a bone; calibrate a subject with more markers."
    )


def describe_misfit(
    subject: Subject, frames: MarkerFrames, seen: Bool[np.ndarray, "F N"], best: PointPose | None
) -> str:
    """Describe how badly the best pose explains the points, and list the bones without points."""
    if best is None:
        return (
            f"In no frame do three points have the distances of three markers on one bone of the subject; check the unit, and "
            f"that the {len(frames.labels)} points are of this subject."
        )
    used = np.asarray(subject.weights) > 0
    bones, without = np.asarray(subject.bones), []
    for bone, name in enumerate(subject.skeleton.names):
        on = (bones == bone) & used
        if on.any() and (best.columns[on] >= 0).mean() < 0.5:
            without.append(name)
    return (
        f"The subject does not explain the points: the best pose, in frame {best.frame}, has {int((best.columns >= 0).sum())} of "
        f"{int(used.sum())} markers within {1e3 * GATES[-1]:.0f} mm of {int(seen[best.frame].sum())} points; no points fit "
        f"{', '.join(without[:MAX_LISTED])}{', ...' if len(without) > MAX_LISTED else ''}. Check that the points are of this subject, with "
        "its markers at the same positions on the body."
    )


def describe_labels(
    subject: Subject,
    tracks: tuple[TrackLabel, ...],
    seen: Bool[np.ndarray, "F N"],
    doubtful: Bool[np.ndarray, "F"],
    given: list[str],
) -> tuple[str, ...]:
    """Describe contradicted labels, points without a label, missing markers and doubtful frames."""
    count, messages = len(seen), []
    for name in given:
        mine = [one for one in tracks if one.name == name]
        total = sum(one.end - one.begin for one in mine)
        wrong = np.zeros(count, bool)
        for one in mine:
            wrong[one.begin : one.end] |= one.label != name
        if wrong.sum() > MIN_CONTRADICTED * total:
            others = sorted({one.label for one in mine if one.label not in (name, None)}, key=str)
            instead = f"; it is {' or '.join(map(str, others))} there" if others else ""
            messages.append(
                f"The label '{name}' is contradicted by the poses in frames {list_runs(wrong)}{instead}."
            )
    missing = set(subject.labels) - {one.label for one in tracks}
    unused = {label for label, weight in zip(subject.labels, subject.weights, strict=True) if weight == 0}
    if missing - unused:
        messages.append(f"No points were found for {_list_names(sorted(missing - unused))}.")
    empty = doubtful & (seen.sum(1) < MIN_MARKERS)
    if empty.any():
        messages.append(f"Frames with fewer than {MIN_MARKERS} points have no pose: {list_runs(empty)}.")
    if (doubtful & ~empty).any():
        messages.append(
            f"No pose explains half of the points in frames {list_runs(doubtful & ~empty)}; check the labels there."
        )
    return tuple(messages)


def _list_names(names: list[str]) -> str:
    some = ", ".join(names[:MAX_LISTED])
    return some + (f" and {len(names) - MAX_LISTED} more" if len(names) > MAX_LISTED else "")
