"""From the labels of a take to landmarks of the human."""

import functools
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from ...arguments import checked
from . import clinical, isb, motion_capture, opensim, vicon
from .landmarks import landmarks
from .marker_table import LOOSE_DEVIATION, Placement, expand_table, normalise_label
from .virtual_points import is_virtual
from .words import PLATES, WORDS

#: share of the labels that begin or end alike, such as with the name of the person
_COMMON_SHARE = 0.6
_SIDES = ("L", "R", "LEFT", "RIGHT")


class MarkerSet(NamedTuple):
    """What the labels of a take's M markers tell about their positions on the human.

    `names` of landmarks, such as `left knee_lateral` and `c7`, and `bones`, joints of the human that carry the
    markers; both are None where unknown. `deviations` of the markers from their landmarks and `heights` of their
    centres above the skin are in metres, NaN where unknown. `virtual` points are no markers: joint centres,
    centres of mass and axes of segments. `sets` tell which set each label is from, `name` the set of most.
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
    """Recognise markers by their labels.

    The set is the one with most of the labels. Labels that it does not have are looked up in the other sets,
    then as words, then as numbered markers on plates. A label about which the other sets disagree stays
    unknown. Case, dots, blanks and underscores do not count, nor does a beginning or an ending that
    most labels share, such as the person's name. Sides are `L`, `R`, `Left` or `Right` in front or at the end.
    """
    forms = max(_variants(labels), key=lambda form: _count_known(form))
    counts = {name: sum(form in table for form in forms) for name, table in _tables().items()}
    # of two sets that have as many of the labels, the smaller one
    ranked = sorted(counts, key=lambda name: (-counts[name], len(_tables()[name])))
    best = ranked[0] if counts[ranked[0]] >= 2 else None
    placed, sets = [], []
    for form in forms:
        placement, source = _place_label(form, ranked, counts)
        placed.append(placement)
        sets.append(source)
    table = landmarks()
    known = [None if one is None else table[one.landmark] for one in placed]
    deviations = [
        np.nan if one is None or mark is None else one.deviation or mark.deviation
        for one, mark in zip(placed, known, strict=True)
    ]
    return MarkerSet(
        tuple(labels),
        tuple(None if one is None else one.landmark for one in placed),
        tuple(None if mark is None else mark.bone for mark in known),
        np.array(deviations, float),
        np.array([np.nan if one is None else one.height for one in placed], float),
        np.array([is_virtual(form) for form in forms], bool),
        tuple(sets),
        best,
    )


@functools.cache
def _tables() -> dict[str, dict[str, Placement]]:
    modules = (vicon, clinical, opensim, motion_capture, isb)
    return {table.name: expand_table(table, landmarks()) for module in modules for table in module.TABLES}


@functools.cache
def _words() -> dict[str, Placement]:
    return expand_table(WORDS, landmarks())


@functools.cache
def _plates() -> dict[str, Placement]:
    return expand_table(PLATES, landmarks())


def _place_label(
    form: str, ranked: Sequence[str], counts: Mapping[str, int]
) -> tuple[Placement | None, str | None]:
    """Find the placement of a normalised label, and the set that has it."""
    if is_virtual(form):
        return None, None
    first = _tables()[ranked[0]].get(form)
    if first is not None and counts[ranked[0]] >= 2:
        return first, ranked[0]
    others = [(name, _tables()[name][form]) for name in ranked if form in _tables()[name]]
    if others:
        return _agreed(others, counts)
    if form in _words():
        return _words()[form], WORDS.name
    return _plate(form), PLATES.name if _plate(form) is not None else None


def _agreed(
    others: Sequence[tuple[str, Placement]], counts: Mapping[str, int]
) -> tuple[Placement | None, str | None]:
    """Choose among the sets that have a label: that with more of the take's labels, unless equals disagree."""
    name, found = others[0]
    equals = [one for other, one in others if counts[other] == counts[name]]
    bones = {landmarks()[one.landmark].bone for one in equals}
    if len(bones) > 1:
        return None, None
    if len({one.landmark for one in equals}) > 1:
        return found._replace(deviation=LOOSE_DEVIATION), name
    return found, name


def _plate(form: str) -> Placement | None:
    """Find a numbered marker of a plate: `LTH1`, `THIGHR2`, `RSHANKA`."""
    numbered = re.fullmatch(r"([A-Z]+?)(\d{1,2}|[A-H])", form)
    return None if numbered is None else _plates().get(numbered[1])


def _count_known(forms: Sequence[str]) -> float:
    """Count the labels of the best set, and with less weight those of any."""
    tables = [*_tables().values(), _words()]
    own = max(sum(form in table for form in forms) for table in tables)
    return own + 0.5 * sum(
        any(form in table for table in tables) or _plate(form) is not None for form in forms
    )


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
