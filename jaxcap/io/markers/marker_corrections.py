"""Corrections of the assignment of markers to segments, read and written as text.

    # marker  segment  weight
    RMFE      -        0
    LSHO      trunk    0.5

The segment `-`, or the weight 0, makes a marker loose. The default weight is one.
"""

from collections.abc import Mapping
from pathlib import Path

from ...errors import InputError
from ..system.atomic import write_text
from ..system.reader_errors import reader_of
from ..text import numbered_lines, parse_floats, read_text, shortened


@reader_of("marker corrections")
def read_corrections(path: str | Path) -> dict[str, tuple[str, float]]:
    """Read corrections as marker -> (segment, weight).

    They are for `markers.segments.marker_partition.apply_corrections` and `fit_local`.

    **Raises:** `InputError` with file and line, for a line of fewer than two or more than three words, a
    weight that is not a number from 0 to 1, or a duplicate marker.
    """
    corrections: dict[str, tuple[str, float]] = {}
    for number, line in numbered_lines(read_text(path)):
        words, where = line.split(), f"{path}:{number}"
        if len(words) not in (2, 3):
            raise InputError(
                f"{where}: '{shortened(line)}' has {len(words)} words; expected a marker, its segment and an optional weight."
            )
        marker, segment = words[:2]
        named = f"the weight of '{shortened(marker)}'"
        weight = parse_floats(words[2:], where, named)[0] if len(words) == 3 else 1.0
        if not 0 <= weight <= 1:
            raise InputError(f"{where}: {named} is {weight:g}; expected a number from 0 to 1.")
        if marker in corrections:
            raise InputError(
                f"{where}: the marker '{shortened(marker)}' occurs twice; keep one of its lines."
            )
        corrections[marker] = (segment, 0.0 if segment == "-" else weight)
    return corrections


def write_corrections(path: str | Path, corrections: Mapping[str, tuple[str, float]]) -> None:
    """Write corrections as `read_corrections` reads them.

    **Raises:** `InputError` if a name has a blank or a `#`, or the file cannot be written.
    """
    for marker, (segment, _) in corrections.items():
        for name in (marker, segment):
            if not name or len(name.split()) != 1 or "#" in name:
                raise InputError(
                    f"{path}: the name '{name}' cannot be written; use names without blanks and '#'."
                )
    lines = [f"{marker} {segment} {weight:.9g}" for marker, (segment, weight) in corrections.items()]
    write_text(path, "\n".join(["# marker segment weight", *lines]) + "\n")
