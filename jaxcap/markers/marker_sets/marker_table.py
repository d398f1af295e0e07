"""A marker set as a table of its labels."""

import re
from collections.abc import Iterator, Mapping
from types import MappingProxyType
from typing import NamedTuple

from ..body_shape.surface_markers import MARKER_HEIGHT

#: standard deviations of the placement of markers on plates and wands, and of those somewhere on a side of a
#: segment, metres
PLATE_DEVIATION, LOOSE_DEVIATION = 0.06, 0.05
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


def expand_table(table: MarkerTable, landmarks: Mapping[str, object]) -> dict[str, Placement]:
    """Build the placements of a table by normalised labels.

    A label as a whole comes before one with a side, and a side in front before one at the end.
    """
    placed: dict[str, Placement] = {}
    for landmark, labels in table.whole.items():
        placed |= {
            normalise_label(label): Placement(landmark, None, MARKER_HEIGHT) for label in labels.split()
        }
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
            for side, form in _with_side(label, position):
                name = landmark if landmark in landmarks else f"{side} {landmark}"
                placed.setdefault(form, Placement(name, deviation, height))
    return placed


def _with_side(label: str, position: int) -> Iterator[tuple[str, str]]:
    """Yield sides and normalised forms of a label: the side as a letter or a word in front, or at the end."""
    for side, letter in (("left", "L"), ("right", "R")):
        if "?" in label:
            forms = [label.replace("?", letter), label.replace("?", side)] if position == 0 else []
        else:
            forms = [
                [letter + label],
                [side + label, label + side],
                [label + letter] if len(normalise_label(label)) >= _MIN_SUFFIXED else [],
            ][position]
        for form in forms:
            yield side, normalise_label(form)
