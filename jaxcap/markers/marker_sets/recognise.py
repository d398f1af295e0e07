"""From the labels of a take to landmarks of the human."""

import functools
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from ...arguments import checked
from . import clinical, isb, laboratories, motion_capture, opensim, vicon
from .landmarks import landmarks
from .marker_table import LOOSE_DEVIATION, MarkerTable, Placement, expand_table, normalise_label
from .virtual_points import virtual_labels
from .words import LETTER_PAIRS, PLATES, WORDS

#: share of the labels that begin or end alike, such as with the name of the person
_COMMON_SHARE = 0.6
#: labels that a set must have
_MIN_LABELS = 3
_SIDES = ("L", "R", "LEFT", "RIGHT")
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


@checked
def recognise_markers(labels: Sequence[str]) -> MarkerSet:
    """Find the landmarks of markers by their labels.

    The set is the one with most of the labels. Labels that it does not have are looked up in the other sets,
    then as words, then as numbered markers on plates. A label about which the other sets disagree stays
    unknown. Case, dots, blanks and underscores do not count, nor does a beginning or an ending that
    most labels share, such as the person's name. Sides are `L`, `R`, `Left` or `Right` in front or at the end.
    """
    forms = max(_variants(labels), key=_count_known)
    counts = {name: sum(form in table for form in forms) for name, table in _tables().items()}
    ranked = sorted(counts, key=lambda name: -counts[name])
    if counts[ranked[0]] < _MIN_LABELS:
        counts = dict.fromkeys(counts, 0)
    plates = _plates() | _letter_plates(forms)
    computed, lettered = virtual_labels(forms), _lettered_plates(forms)
    placed = [
        (None, "computed")
        if form in computed
        else _place_plate(form[:-1], plates)
        if form in lettered
        else _place_label(form, ranked, counts, plates)
        for form in forms
    ]
    marks = [None if one is None else landmarks()[one.landmark] for one, _ in placed]
    return MarkerSet(
        tuple(labels),
        tuple(None if one is None else one.landmark for one, _ in placed),
        tuple(None if mark is None else mark.bone for mark in marks),
        np.array(
            [
                np.nan if one is None or mark is None else one.deviation or mark.deviation
                for (one, _), mark in zip(placed, marks, strict=True)
            ],
            float,
        ),
        np.array([np.nan if one is None else one.height for one, _ in placed], float),
        np.array([one is None and source is not None for one, source in placed], bool),
        tuple(source for _, source in placed),
        ranked[0] if counts[ranked[0]] else None,
    )


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
def _words() -> Places:
    return expand_table(WORDS, landmarks())


@functools.cache
def _plates() -> dict[str, Placement | None]:
    return expand_table(PLATES, landmarks())


def _place_label(
    form: str, ranked: Sequence[str], counts: Mapping[str, int], plates: Places
) -> tuple[Placement | None, str | None]:
    """Find the placement of a normalised label, and the set that has it; a computed point has a set only."""
    first = _tables()[ranked[0]]
    if form in first and counts[ranked[0]]:
        return first[form], ranked[0]
    # what another set computes may be a marker here
    others = [(name, one) for name in ranked if (one := _tables()[name].get(form)) is not None]
    if others:
        return _agreed(others, counts)
    if form in _words():
        return _words()[form], WORDS.name
    return _place_plate(_plate_stem(form), plates)


def _place_plate(stem: str, plates: Places) -> tuple[Placement | None, str | None]:
    return (plates[stem], PLATES.name) if stem in plates else (None, None)


def _agreed(
    others: Sequence[tuple[str, Placement]], counts: Mapping[str, int]
) -> tuple[Placement | None, str | None]:
    """Choose among the sets that have a label: that with more of the take's labels, unless equals disagree."""
    name, first = others[0]
    equals = [landmarks()[one.landmark] for other, one in others if counts[other] == counts[name]]
    if len({mark.bone for mark in equals}) > 1:
        return None, None
    if len(set(equals)) > 1:
        return first._replace(deviation=LOOSE_DEVIATION), name
    return first, name


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


def _variants(labels: Sequence[str]) -> list[tuple[str, ...]]:
    """Normalise the labels, as they are and without the words that most of them begin or end with."""
    words = [re.split(r"[_\-. ]+", label.rsplit(":", 1)[-1]) for label in labels]
    variants = [tuple(normalise_label(label) for label in labels)]
    for end in (0, -1):
        for _ in range(3):
            shared = Counter(word[end].upper() for word in words if len(word) > 1)
            if not shared:
                break
            common, count = shared.most_common(1)[0]
            if count < _COMMON_SHARE * len(words) or common in _SIDES:
                break
            words = [
                (word[1:] if end == 0 else word[:-1])
                if len(word) > 1 and word[end].upper() == common
                else word
                for word in words
            ]
            variants.append(tuple(normalise_label("".join(word)) for word in words))
    return variants
