"""From the labels of a take to landmarks of the human."""

import functools
import re
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from ...arguments import checked
from . import clinical, isb, laboratories, motion_capture, opensim, vicon
from .label_forms import exchanged_sides, label_groups, label_variants, repeated_labels
from .landmarks import JOINT_DEVIATION, joint_landmarks, landmarks, mirror_landmark
from .marker_table import LOOSE_DEVIATION, MarkerTable, Placement, expand_table
from .virtual_points import virtual_labels
from .words import LETTER_PAIRS, PLATES, WORDS

#: labels that a set must have
_MIN_LABELS = 3
#: share of the first set's labels that another set needs, if words in general are not to count more
_LIKELY_SHARE = 0.5
#: least number of markers with the same name and different numbers, which are on one plate
_MIN_FAMILY = 2
#: of sets that explain as many labels, the first one counts
_SETS = tuple(
    table
    for module in (vicon, clinical, opensim, motion_capture, isb, laboratories)
    for table in module.TABLES
)


class MarkerSet(NamedTuple):
    """Positions on the human of the M markers of a take, as their labels state them.

    `names` of landmarks, such as `left knee_lateral` and `c7`, and `bones`, joints of the human that carry the
    markers; both are None where unknown. `deviations` of the markers from their landmarks and `heights` of their
    centres above the skin are in metres, NaN where unknown. `virtual` points are no markers: joint centres,
    centres of mass and axes of segments. `sets` are the sets that the labels are from, `name` is the set of most.
    """

    labels: tuple[str, ...]
    names: tuple[str | None, ...]
    bones: tuple[str | None, ...]
    deviations: Float[np.ndarray, "M"]
    heights: Float[np.ndarray, "M"]
    virtual: Bool[np.ndarray, "M"]
    sets: tuple[str | None, ...]
    name: str | None


class _Reading(NamedTuple):
    """The reading of a label: the placement, or None if it is unknown or that of a computed point, and the set that has it."""

    placement: Placement | None = None
    source: str | None = None


@checked
def recognise_markers(labels: Sequence[str]) -> MarkerSet:
    """Find the landmarks of markers by their labels.

    The set is the one with most of the labels. Labels that it does not have are looked up in the other sets,
    then as words, then as numbered markers on plates. A label about which the other sets disagree stays
    unknown, and no two labels are at one landmark exactly. Case, dots, blanks and underscores do not count, nor does a beginning or an ending that
    most labels share, such as the person's name. Sides are `L`, `R`, `Left` or `Right` in front or at the end, or `G` and `D` at the end.

    Joints that a network sees in images are landmarks, at the centres of the joints, if a take has no other markers.
    """
    repeated = repeated_labels(labels)
    first = [label for label in labels if label not in repeated]
    groups, names, read = label_groups(first), [], dict[str, _Reading]()
    for group in groups:
        name, own = _read_labels(group)
        if name in laboratories.POINTS_AT_JOINTS and len(groups) > 1:
            # the markers of the other group are computed from them
            own = dict.fromkeys(group, _Reading(None, name))
        names.append(name)
        read |= own
    return _make_set(labels, [read.get(label, _Reading()) for label in labels], names[0])


def _make_set(labels: Sequence[str], readings: Sequence[_Reading], name: str | None) -> MarkerSet:
    placed = [one.placement for one in readings]
    known = landmarks() | joint_landmarks()
    marks = [None if one is None else known[one.landmark] for one in placed]
    return MarkerSet(
        tuple(labels),
        tuple(None if one is None else one.landmark for one in placed),
        tuple(None if mark is None else mark.bone for mark in marks),
        np.array(
            [
                np.nan if one is None or mark is None else one.deviation or mark.deviation
                for one, mark in zip(placed, marks, strict=True)
            ],
            float,
        ),
        np.array([np.nan if one is None else one.height for one in placed], float),
        np.array([one.placement is None and one.source is not None for one in readings], bool),
        tuple(one.source for one in readings),
        name,
    )


def _read_labels(labels: Sequence[str]) -> tuple[str | None, dict[str, _Reading]]:
    """Read the labels of one set of points; return the name of the marker set, too."""
    forms = max(label_variants(labels), key=_count_known)
    counts = {name: sum(form in table for form in forms) for name, table in _tables().items()}
    ranked = sorted(counts, key=lambda name: -counts[name])
    if counts[ranked[0]] < _MIN_LABELS:
        counts = dict.fromkeys(counts, 0)
    plates, families = _plates() | _letter_plates(forms), _families(forms)
    computed, lettered = virtual_labels(forms), _lettered_plates(forms)
    by_label = {
        label: _Reading(None, "computed")
        if form in computed
        else _place_plate(form[:-1], plates)
        if form in lettered
        else _place_label(form, ranked, counts, plates, families)
        for label, form in zip(labels, forms, strict=True)
    }
    by_form = dict(zip(labels, forms, strict=True))
    name = ranked[0] if counts[ranked[0]] else None
    if name in laboratories.POINTS_AT_JOINTS:
        return name, {label: _read_key_point(one, by_form[label], name) for label, one in by_label.items()}
    return name, _separate(_mirrored_only(by_label, by_form), by_form, ranked, counts)


def _read_key_point(reading: _Reading, form: str, name: str) -> _Reading:
    """Read a point of a set of estimated points: those at joints are landmarks, and none is as exact as a marker."""
    placement = _joints(name).get(form, reading.placement)
    if placement is None:
        return reading
    return _Reading(placement._replace(deviation=JOINT_DEVIATION, height=0.0), name)


def landmark_counts() -> Counter[str]:
    """Count the marker sets that have a marker at each landmark, or somewhere near it."""
    return Counter(
        name
        for table in _tables().values()
        for name in {one.landmark for one in table.values() if one is not None}
    )


Places = Mapping[str, Placement | None]


@functools.cache
def _tables() -> dict[str, Places]:
    return {table.name: expand_table(table, landmarks()) for table in _SETS}


@functools.cache
def _joints(name: str) -> Mapping[str, Placement]:
    """Build the placements of a set's points at joints by normalised labels."""
    table = MarkerTable("", sided=laboratories.POINTS_AT_JOINTS[name])
    return {form: one for form, one in expand_table(table, joint_landmarks()).items() if one is not None}


@functools.cache
def _words() -> Places:
    return expand_table(WORDS, landmarks())


@functools.cache
def _plates() -> dict[str, Placement | None]:
    return expand_table(PLATES, landmarks())


def _place_label(
    form: str, ranked: Sequence[str], counts: Mapping[str, int], plates: Places, families: Collection[str]
) -> _Reading:
    """Find the placement of a normalised label, and the set that has it; a computed point has a set only."""
    first = _tables()[ranked[0]]
    if form in first and counts[ranked[0]]:
        return _Reading(first[form], ranked[0])
    stem = _plate_stem(form)
    if stem in families and stem in plates:
        return _place_plate(stem, plates)
    # what another set computes may be a marker here
    others = [(name, one) for name in ranked if (one := _tables()[name].get(form)) is not None]
    likely = [(name, one) for name, one in others if counts[name] >= _LIKELY_SHARE * counts[ranked[0]]]
    if likely:
        return _agreed(likely, counts)
    if form in _words():
        return _Reading(_words()[form], WORDS.name)
    return _agreed(others, counts) if others else _place_plate(stem, plates)


def _place_plate(stem: str, plates: Places) -> _Reading:
    return _Reading(plates[stem], PLATES.name) if stem in plates else _Reading()


def _agreed(others: Sequence[tuple[str, Placement]], counts: Mapping[str, int]) -> _Reading:
    """Choose among the sets that have a label: that with more of the take's labels, unless equals disagree."""
    name, first = others[0]
    equals = [landmarks()[one.landmark] for other, one in others if counts[other] == counts[name]]
    if len({mark.bone for mark in equals}) > 1:
        return _Reading()
    if len(set(equals)) > 1:
        return _Reading(first._replace(deviation=LOOSE_DEVIATION), name)
    return _Reading(first, name)


def _mirrored_only(readings: Mapping[str, _Reading], forms: Mapping[str, str]) -> dict[str, _Reading]:
    """Keep the readings of labels that are read as mirrored landmarks where they differ in the letter of the side only.

    `LMAL` may be the left `MAL`, and the left `LMA`; next to `RMAL` it cannot be the latter.
    """
    by_form = {form: label for label, form in forms.items()}
    result = dict(readings)
    for label, form in forms.items():
        other = next((by_form[one] for one in exchanged_sides(form) if one in by_form), None)
        if other is None:
            continue
        own, mirrored = (_landmark_of(readings[one]) for one in (label, other))
        if mirrored != (None if own is None else mirror_landmark(own)):
            result[label] = result[other] = _Reading()
    return result


def _landmark_of(reading: _Reading) -> str | None:
    return None if reading.placement is None else reading.placement.landmark


def _separate(
    readings: Mapping[str, _Reading],
    forms: Mapping[str, str],
    ranked: Sequence[str],
    counts: Mapping[str, int],
) -> dict[str, _Reading]:
    """Correct the readings of labels that are read as one landmark: no two markers of a person are at the same place.

    A label for which another set names a free landmark on the same bone gets that one. The others are known to be near the landmark only.
    """
    result, at = dict(readings), {}
    for label, one in readings.items():
        if one.placement is not None and one.placement.deviation is None:
            at.setdefault((label.rpartition(":")[0], one.placement.landmark), []).append(label)
    taken = {landmark for _, landmark in at}
    for (_, landmark), labels in at.items():
        if len(labels) < 2:
            continue
        free = {label: _other_reading(forms[label], landmark, taken, ranked, counts) for label in labels}
        movable = [label for label, one in free.items() if one is not None]
        moved = movable[0] if len(movable) == 1 else None
        for label in labels:
            one, other = readings[label], free[label]
            if label == moved and other is not None:
                result[label] = other
            elif moved is None or len(labels) > 2:
                result[label] = one._replace(placement=_loosened(one.placement))
    return result


def _other_reading(
    form: str, landmark: str, taken: Collection[str], ranked: Sequence[str], counts: Mapping[str, int]
) -> _Reading | None:
    """Find what another set reads as a free landmark on the same bone; None if there is no such one, or several."""
    bone = landmarks()[landmark].bone
    found = {
        one.landmark: _Reading(one, name)
        for name in (*reversed(ranked), WORDS.name)
        for one in [(_words() if name == WORDS.name else _tables()[name]).get(form)]
        if one is not None and one.landmark not in taken and landmarks()[one.landmark].bone == bone
    }
    return next(iter(found.values())) if len(found) == 1 else None


def _loosened(placement: Placement | None) -> Placement | None:
    return None if placement is None else placement._replace(deviation=LOOSE_DEVIATION)


def _families(forms: Sequence[str]) -> frozenset[str]:
    """Find the stems that several labels have, with different numbers or letters."""
    stems = Counter(_plate_stem(form) for form in set(forms))
    return frozenset(stem for stem, count in stems.items() if stem and count >= _MIN_FAMILY)


def _plate_stem(form: str) -> str:
    """Cut the number or letter of a marker on a plate: `LTH1`, `THIGHR2`, `RSHANKA`; empty without one."""
    numbered = re.fullmatch(r"([A-Z]+)\d{1,2}|([A-Z]{5,})[A-D]", form)
    return "" if numbered is None else numbered[1] or numbered[2]


def _lettered_plates(forms: Sequence[str]) -> frozenset[str]:
    """Find labels of plates with a letter for each marker: three or four of `RFTA`, `RFTB`, `RFTC` and `RFTD`."""
    stems = Counter(form[:-1] for form in set(forms) if len(form) > 2 and form[-1] in "ABCD")
    return frozenset(form for form in forms if form[-1:] in tuple("ABCD") and stems[form[:-1]] >= 3)


def _letter_plates(forms: Sequence[str]) -> dict[str, Placement | None]:
    """Build the plates of thigh and shank that have one letter each, such as `LF1` and `LT1`."""
    stems = {_plate_stem(form) for form in forms if form[-1:].isdigit()}
    for thigh, shank in LETTER_PAIRS:
        if {f"L{thigh}", f"L{shank}"} <= stems or {f"R{thigh}", f"R{shank}"} <= stems:
            pair = MarkerTable("", plates={"thigh_lateral": thigh, "shank_lateral": shank})
            return expand_table(pair, landmarks())
    return {}


def _count_known(forms: Sequence[str]) -> float:
    """Count the labels of the best set, and with less weight those of any."""
    tables = [*_tables().values(), _words()]
    own = max(sum(form in table for form in forms) for table in tables)
    anywhere = sum(any(form in table for table in tables) or _plate_stem(form) in _plates() for form in forms)
    return own + 0.5 * anywhere
