"""The people and the rigid props of a recording, and the markers of neither."""

from collections.abc import Collection, Mapping, Sequence
from itertools import count
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from ...arguments import checked
from ...observe.marker_labels import affix_groupings, group_by_colon, label_stem
from ...observe.markers import MarkerFrames
from ..human.check_person import find_doubled_labels, has_landmarks
from ..marker_sets.recognise import recognise_markers
from ..segments.rigid_motion import (
    MIN_DISPLACEMENT,
    displacement,
    distance_ranges,
    find_rigid_sets,
    is_rigid,
    own_motion,
)

#: least motion of a prop without a prefix against each marker of a person, metres: with labels such as Sword1, Sword2 and
#: Sword3, and with labels that tell nothing. Plates on forearm and upper arm move by 0.2 m against each other
MIN_NAMED_MOTION, MIN_OWN_MOTION = 0.1, 0.25
#: name of a person without a prefix
UNNAMED_PERSON = "person"


class SubjectMarkers(NamedTuple):
    """The markers of one subject."""

    name: str
    #: with labels without the subject's prefix
    frames: MarkerFrames
    #: the labels in the recording
    labels: tuple[str, ...]


class UnassignedMarkers(NamedTuple):
    """Markers of no subject, and why."""

    labels: tuple[str, ...]
    #: a sentence
    reason: str


class SubjectSplit(NamedTuple):
    """The subjects of a recording, in the order of their first markers."""

    people: tuple[SubjectMarkers, ...]
    props: tuple[SubjectMarkers, ...]
    unassigned: tuple[UnassignedMarkers, ...]


@checked
def split_subjects(frames: MarkerFrames) -> SubjectSplit:
    """Split a recording into people, rigid props, and markers of neither.

    Names are prefixes before a colon; without any, other prefixes and suffixes with which at least two groups have the labels
    of people: `Anna_LASI`, `LASI1`. A named group is a person if its labels are landmarks, and a prop if all its distances
    are constant. Without names, a person is all markers with known labels, and a prop is a rigid set of unknown labels that
    moves against all markers of the person. A rigid set in a hand may be a part of the person, and stays with the person.
    No two subjects have the same name.
    """
    seen = np.asarray(np.any(np.asarray(frames.visible), axis=0))
    groups = find_named_groups(frames)
    named = {index for members in groups.values() for index in members}
    rest = [index for index in np.flatnonzero(seen).tolist() if index not in named]
    recording = _Recording(frames, distance_ranges(frames))
    parts = []
    for name, members in groups.items():
        shown = {index: label for index, label in members.items() if seen[index]}
        if shown:
            parts.append(_place_named(recording, name, shown))
    if rest:
        unnamed = _place_unnamed(recording, rest, any(part.people for part in parts))
        parts.append(_with_unique_names(unnamed, groups))
    never = tuple(label for label, some in zip(frames.labels, seen, strict=True) if not some)
    if never:
        parts.append(_unassigned(never, f"{_list(never)} are never visible."))
    return SubjectSplit(
        tuple(one for part in parts for one in part.people),
        tuple(one for part in parts for one in part.props),
        tuple(one for part in parts for one in part.unassigned),
    )


def _with_unique_names(split: SubjectSplit, taken: Collection[str]) -> SubjectSplit:
    """Give subjects names that are not taken: `prop1`, `prop2` without a name, and `Sword_2` where `Sword` is taken."""
    used = set(taken)

    def name_of(one: SubjectMarkers) -> SubjectMarkers:
        names = (
            (f"{one.name}_{number}" if number > 1 else one.name for number in count(1))
            if one.name
            else (f"prop{number}" for number in count(1))
        )
        name = next(name for name in names if name not in used)
        used.add(name)
        return one._replace(name=name)

    return split._replace(people=tuple(map(name_of, split.people)), props=tuple(map(name_of, split.props)))


def find_named_groups(frames: MarkerFrames) -> dict[str, dict[int, str]]:
    """Find the groups of markers that a prefix or suffix names, with the labels without it; empty where there are none."""
    groups = group_by_colon(frames.labels)
    if groups:
        return groups
    for found in affix_groupings(frames.labels):
        if sum(_is_person(select_members(frames, members)) for members in found.values()) > 1:
            return {name: members for name, members in found.items() if len(members) > 2}
    return {}


def select_members(frames: MarkerFrames, members: Mapping[int, str]) -> MarkerFrames:
    """Select markers by their indices, with new labels; a second marker of a label gets a number."""
    labels: list[str] = []
    for label in members.values():
        number, unique = 1, label
        while unique in labels:
            number += 1
            unique = f"{label}_{number}"
        labels.append(unique)
    columns = np.array(list(members), int)
    return MarkerFrames(
        np.asarray(frames.positions)[:, columns],
        np.asarray(frames.visible)[:, columns],
        tuple(labels),
        frames.rate,
    )


def _is_person(frames: MarkerFrames) -> bool:
    return has_landmarks(recognise_markers(frames.labels), frames)


class _Recording(NamedTuple):
    """All markers of a recording, and the ranges of the distances between them, metres."""

    frames: MarkerFrames
    ranges: Float[np.ndarray, "M M"]

    def labels(self, columns: Sequence[int]) -> tuple[str, ...]:
        return tuple(self.frames.labels[index] for index in columns)

    def prop(self, name: str, columns: Sequence[int]) -> SubjectMarkers:
        labels = self.labels(columns)
        return SubjectMarkers(
            name, select_members(self.frames, dict(zip(columns, labels, strict=True))), labels
        )


def _unassigned(labels: tuple[str, ...], reason: str) -> SubjectSplit:
    return SubjectSplit((), (), (UnassignedMarkers(labels, reason),))


def _place_named(recording: _Recording, name: str, members: Mapping[int, str]) -> SubjectSplit:
    """Decide if a named group is a person, a prop, or neither."""
    own, columns = select_members(recording.frames, members), list(members)
    labels = recording.labels(columns)
    person = _is_person(own)
    if person and (doubled := find_doubled_labels(own)):
        return _unassigned(
            labels,
            f"{len(doubled)} labels of '{name}' occur twice ({_list(doubled)}), so these are markers of two people under one "
            "name; give the markers of each a prefix such as Anna:LASI.",
        )
    if is_rigid(recording.ranges, columns) and (not person or displacement(own) > MIN_DISPLACEMENT):
        return SubjectSplit((), (SubjectMarkers(name, own, labels),), ())
    if person:
        return SubjectSplit((SubjectMarkers(name, own, labels),), (), ())
    return _unassigned(labels, _describe_unknown(name, own, recording.ranges, columns))


def _place_unnamed(recording: _Recording, rest: list[int], has_people: bool) -> SubjectSplit:
    """Find a person, props with labels of their own, and the rest among markers without a subject's name."""
    whole = dict(zip(rest, recording.labels(rest), strict=True))
    known = recognise_markers(list(whole.values()))
    if not has_landmarks(known, select_members(recording.frames, whole)):
        return _place_unknown(recording, rest, has_people)
    unknown = [
        index
        for index, name, virtual in zip(rest, known.names, known.virtual, strict=True)
        if name is None and not virtual
    ]
    landmarks = [index for index in rest if index not in unknown]
    found = _props_among(recording, unknown, landmarks)
    taken = {index for _, some in found for index in some}
    own = {index: label for index, label in whole.items() if index not in taken}
    person = _place_named(recording, UNNAMED_PERSON, own)
    return person._replace(props=(*person.props, *(recording.prop(name, some) for name, some in found)))


def _place_unknown(recording: _Recording, rest: list[int], has_people: bool) -> SubjectSplit:
    """Find props among markers without a subject's name and without labels of a person.

    Segments of an animal, or of a person without labels, are rigid too: several rigid sets are props only next to people
    with prefixes.
    """
    sets = _sets_by_stem(recording, rest)
    left = [index for index in rest if all(index not in some for _, some in sets)]
    sets += [("", some) for some in find_rigid_sets(recording.ranges, left)]
    alone = [index for index in rest if all(index not in some for _, some in sets)]
    # so is a person without labels who stands still
    moves = displacement(select_members(recording.frames, dict.fromkeys(rest, ""))) > MIN_DISPLACEMENT
    if not (sets and (has_people or (len(sets) == 1 and not alone and moves))):
        sets, alone = [], rest
    props = tuple(recording.prop(name, some) for name, some in sets)
    if not alone:
        return SubjectSplit((), props, ())
    labels = recording.labels(alone)
    reason = f"{_list(labels)} have labels of no person and are on no rigid body of their own."
    return _unassigned(labels, reason)._replace(props=props)


def _props_among(
    recording: _Recording, unknown: list[int], landmarks: list[int]
) -> list[tuple[str, list[int]]]:
    """Find the rigid sets of unknown labels that move against all of a person's landmarks."""
    ranges = recording.ranges
    found = [
        (name, some)
        for name, some in _sets_by_stem(recording, unknown)
        if own_motion(ranges, some, landmarks) > MIN_NAMED_MOTION
    ]
    left = [index for index in unknown if all(index not in some for _, some in found)]
    found += [
        ("", some)
        for some in find_rigid_sets(ranges, left)
        if own_motion(ranges, some, landmarks) > MIN_OWN_MOTION
    ]
    return found


def _sets_by_stem(recording: _Recording, candidates: list[int]) -> list[tuple[str, list[int]]]:
    """Find the rigid sets whose labels differ only in their numbers, such as Sword1, Sword2 and Sword3."""
    stems: dict[str, list[int]] = {}
    for index in candidates:
        stems.setdefault(label_stem(recording.frames.labels[index]), []).append(index)
    return [(stem, some) for stem, some in stems.items() if stem and is_rigid(recording.ranges, some)]


def _describe_unknown(
    name: str, own: MarkerFrames, ranges: Float[np.ndarray, "M M"], columns: list[int]
) -> str:
    if len(columns) < 3:
        return f"'{name}' has {len(columns)} markers, which are no person; a rigid prop needs three."
    inside = ranges[np.ix_(columns, columns)]
    widest = float(np.nanmax(inside)) if np.isfinite(inside).any() else np.nan
    return (
        f"'{name}' is no person, as its labels are no landmarks ({_list(own.labels)}), and no rigid prop, as its distances "
        f"change by {1e3 * widest:.0f} mm."
    )


def _list(labels: Sequence[str]) -> str:
    return ", ".join(labels[:6]) + (", ..." if len(labels) > 6 else "")
