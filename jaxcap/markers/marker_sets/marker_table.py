"""A marker set as a table of its labels."""

import re
from collections.abc import Iterator, Mapping
from types import MappingProxyType
from typing import NamedTuple

from ..body_shape.surface_markers import MARKER_HEIGHT

#: standard deviations of the placement of markers on plates and wands, and of those somewhere on a side of a
#: segment, metres
PLATE_DEVIATION, LOOSE_DEVIATION = 0.08, 0.05
#: distances of their centres from the skin, metres
PLATE_HEIGHT, WAND_HEIGHT = 0.02, 0.08

_NONE: Mapping[str, str] = MappingProxyType({})
#: shortest label that may have a letter for its side at the end
_MIN_SUFFIXED = 3


class MarkerTable(NamedTuple):
    """The labels of a marker set.

    Each entry has a landmark, and labels of markers on it, separated by blanks. Labels of a side are without
    it; they may have it in front or at the end, as a letter or a word. A `?` is the side inside a label.
    """

    name: str
    #: on both sides; the landmark may be one of the middle
    sided: Mapping[str, str] = _NONE
    #: labels as a whole, with the landmark's full name
    whole: Mapping[str, str] = _NONE
    #: on both sides, somewhere near the landmark
    loose: Mapping[str, str] = _NONE
    #: on both sides, on plates
    plates: Mapping[str, str] = _NONE
    #: on both sides, on wands
    wands: Mapping[str, str] = _NONE
    #: labels of points that this set's program computes, with or without a side
    computed: str = ""
    #: letters of the sides
    letters: str = "LR"


class Placement(NamedTuple):
    """The landmark of a label."""

    landmark: str
    #: standard deviation, metres; None for the landmark's own
    deviation: float | None
    #: height of the marker's centre above the skin, metres
    height: float


def normalise_label(label: str) -> str:
    """Keep letters and digits of a label after its last colon, in capitals."""
    return re.sub(r"[^A-Z0-9]", "", label.rsplit(":", 1)[-1].upper())


def expand_table(table: MarkerTable, landmarks: Mapping[str, object]) -> dict[str, Placement | None]:
    """Build the placements of a table by normalised labels, None for computed points.

    Computed points come first, then labels as a whole, those with a side in front, and those with one at the end.
    A label of a landmark of the middle needs no side.
    """
    computed = [
        form
        for label in table.computed.split()
        for position in range(3)
        for _, form in [("", normalise_label(label)), *_with_side(label, position, table.letters)]
    ]
    placed: dict[str, Placement | None] = dict.fromkeys(computed)
    for landmark, labels in table.whole.items():
        for label in labels.split():
            placed.setdefault(normalise_label(label), Placement(landmark, None, MARKER_HEIGHT))
    kinds = (
        (table.sided, None, MARKER_HEIGHT), (table.loose, LOOSE_DEVIATION, MARKER_HEIGHT),
        (table.plates, PLATE_DEVIATION, PLATE_HEIGHT), (table.wands, LOOSE_DEVIATION, WAND_HEIGHT),
    )  # fmt: skip
    rows = [
        (landmark, label, deviation, height)
        for group, deviation, height in kinds
        for landmark, labels in group.items()
        for label in labels.split()
    ]
    # in the order of how sure the side is
    for position in range(3):
        for landmark, label, deviation, height in rows:
            middle = landmark in landmarks
            if middle:
                placed.setdefault(normalise_label(label), Placement(landmark, deviation, height))
            for side, form in _with_side(label, position, table.letters):
                name = landmark if middle else f"{side} {landmark}"
                placed.setdefault(form, Placement(name, deviation, height))
    return placed


def _with_side(label: str, position: int, letters: str = "LR") -> Iterator[tuple[str, str]]:
    """Yield sides and normalised forms of a label: the side as a letter or a word in front, or at the end."""
    for side, letter in zip(("left", "right"), letters, strict=True):
        if "?" in label:
            forms = [label.replace("?", letter), label.replace("?", side)] if position == 0 else []
        else:
            forms = [
                [letter + label],
                [side + label, label + side, f"{letter}x{label}"],
                [label + letter] if len(normalise_label(label)) >= _MIN_SUFFIXED or letters != "LR" else [],
            ][position]
        for form in forms:
            yield side, normalise_label(form)
