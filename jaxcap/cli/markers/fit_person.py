"""A person's skeleton from labelled markers: what `jaxcap markers fit` prints and writes."""

import math
from collections.abc import Sequence
from typing import Literal

import numpy as np

from ...markers.human.body_lengths import segment_lengths
from ...markers.human.body_size import is_adult
from ...markers.human.check_person import has_landmarks
from ...markers.human.fit_human import HumanFit
from ...markers.marker_sets.recognise import MarkerSet, recognise_markers
from ...markers.recognition.recognise_by_geometry import GeometryRecognition, recognise_by_geometry
from ...observe.markers import MarkerFrames
from ..console.console import ordinal, print_table, say, warn
from ..console.heartbeat import set_activity
from .result_tables import print_doubts


def print_person(fit: HumanFit) -> None:
    """Print the doubts first, then the set of markers, the lengths of the segments, and the person's traits."""
    print_doubts(fit.messages)
    known = fit.marker_set
    named = sum(name is not None for name in known.names)
    say(f"marker set: {known.name or 'none'}; {named} of {len(known.labels)} labels are known landmarks")
    print_lengths(fit)
    tall = float(np.ptp(np.asarray(fit.body.vertices, float)[:, 1]))
    say(f"a person of these proportions is about {tall:.2f} m tall")


def find_landmarks(frames: MarkerFrames, up: str | None = None) -> MarkerSet:
    """Find the landmarks of markers by their labels, or by their geometry where these are unknown, and print the latter.

    `up` is the up axis if it is known, such as "z" or "-y".
    """
    known = recognise_markers(frames.labels)
    if has_landmarks(known, frames):
        return known
    set_activity("finding the landmarks of markers with unknown labels")
    letter: dict[str, Literal["x", "y", "z"]] = {"x": "x", "y": "y", "z": "z"}
    found = recognise_by_geometry(frames, up=None if up is None else letter[up[-1]])
    print_landmarks(found)
    return found.marker_set


def print_landmarks(found: GeometryRecognition) -> None:
    """Print the landmarks that geometry gave to markers, a row for each bone."""
    for sentence in found.messages:
        warn(sentence)
    by_bone: dict[str, list[str]] = {}
    for label, name, bone in zip(
        found.marker_set.labels, found.marker_set.names, found.marker_set.bones, strict=True
    ):
        if bone is not None:
            by_bone.setdefault(bone, []).append(f"{label} {name}")
    print_table(["bone", "markers"], [[bone, ", ".join(some)] for bone, some in sorted(by_bone.items())])


def print_lengths(fit: HumanFit) -> None:
    """Print a row for each segment: left, right, standard deviation, and percentile among adults."""
    rows = []
    for one in segment_lengths(fit.calibration, fit.subject.skeleton, is_adult=is_adult(fit.traits)):
        right = "" if math.isnan(one.right) else f"{1e3 * one.right:.0f} mm"
        known = "from anatomy" if math.isnan(one.deviation) else f"± {1e3 * one.deviation:.0f} mm"
        known = "" if math.isnan(one.right) else known
        usual = "" if math.isnan(one.percentile) else f"{ordinal(round(one.percentile))} percentile"
        rows.append([one.name, f"{1e3 * one.left:.0f} mm", right, known, usual])
    say("lengths between joint centres:")
    print_table(["segment", "left", "right", "deviation", "among adults"], rows)


def bone_rows(fit: HumanFit) -> Sequence[dict[str, object]]:
    """Collect the lengths for `report.json`, metres."""
    return [
        {
            name: None if isinstance(value, float) and math.isnan(value) else value
            for name, value in one._asdict().items()
        }
        for one in segment_lengths(fit.calibration, fit.subject.skeleton, is_adult=is_adult(fit.traits))
    ]
