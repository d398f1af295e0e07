"""Markers in tables with column names, CSV: a row for each frame, three columns for each marker.

The columns of a marker are named `LKNE.x, LKNE.y, LKNE.z`, or `LKNE_x`, `LKNE:X`, `LKNE x`; or there are two
header rows, labels above axes. Cells that are empty or NaN are gaps. The rate is given by a column `time` in
seconds (`time_ms`, in milliseconds), or by a line `# rate: 120`.
"""

import csv
import io
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ...errors import InputError
from ...observe.markers import MarkerFrames
from ...units import unit_scale
from ..system.atomic import write_text
from ..system.reader_errors import reader_of
from ..text import check_frame_rate, parse_floats, read_text, shortened
from .marker_file import MarkerFile, fill_missing_frames, make_marker_file, shift_from_origin
from .trc import parse_positions

#: a label, a separator, and an axis with an optional unit; blanks are collapsed, and names are limited, as the time of a
#: search grows with their length
_MARKER_COLUMN = re.compile(r"(?P<label>.*\S) ?[._:/|\- ] ?\(?(?P<axis>[xyzXYZ])\)?( ?[\[(]\w+[\])])?")
LONGEST_NAME = 200
_TIME_COLUMN = re.compile(
    r"(time|times|t|seconds|timestamp)[\s_.]*[\[(]?(s|sec|seconds|ms|milliseconds)?[\])]?"
)
_FRAME_COLUMN = re.compile(r"(frame|frames|frame#|index|sample|#)[\s_]*(no|number)?\.?")
_RATE_LINE = re.compile(
    r"#? ?(rate|frame ?rate|datarate)(?: ?[:=,;]| ) ?([^\s,;]+?)[ ,;]*(hz)?[,; ]*", re.IGNORECASE
)


@reader_of("a marker table")
def read_marker_table(
    path: str | Path, unit: str | float | None = None, rate: float | None = None
) -> MarkerFile:
    """Read the markers of a CSV file with cells separated by commas, semicolons or tabs.

    **Arguments:** `unit` of lengths, by default metres; `rate` in frames per second, which overrides that of
    the file. Rows that are missing by the time or frame column become frames without visible markers.

    **Raises:** `InputError`, with the line, if there is no such file, no column belongs to a marker, a marker
    lacks an axis, a cell is no number, a row has too many or too few cells, the rate is unknown, or there are
    no frames.
    """
    path = Path(path)
    text = read_text(path)
    if text.startswith("PathFileType"):
        raise InputError(f"{path}: this is a TRC file; rename it to .trc.")
    said, rows = _rows(path, text)
    if not rows:
        raise InputError(f"{path}: the table is empty; give a row of column names and a row for each frame.")
    names, begin = _column_names(rows)
    names = [_collapse_blanks(name) for name in names]
    long = next((name for name in names if len(name) > LONGEST_NAME), None)
    if long is not None:
        raise InputError(
            f"{path}:{rows[0][0]}: the column '{shortened(long)}' has a name of {len(long)} characters; expected at most "
            f"{LONGEST_NAME}."
        )
    labels, columns = _markers(path, rows[0][0], names)
    width = len(names)
    positions, clock, numbers = [], [], []
    time_at, frame_at = _find(_TIME_COLUMN, names), _find(_FRAME_COLUMN, names)
    for number, cells in rows[begin:]:
        where = f"{path}:{number}"
        if len(cells) != width and any(cells[width:] if len(cells) > width else [True]):
            raise InputError(f"{where}: this row has {len(cells)} cells for {width} columns; it is damaged or cut short.")  # fmt: skip
        positions.append(parse_positions([cells[i] for three in columns for i in three], labels, where))
        if time_at is not None:
            clock += parse_floats([cells[time_at]], where, f"column '{names[time_at]}'")
        if frame_at is not None:
            numbers += parse_floats([cells[frame_at]], where, f"column '{names[frame_at]}'")
    there = np.asarray(positions, float).reshape(len(positions), len(labels), 3)
    full, found = there, None
    if time_at is not None:
        scale = 1e-3 if "m" in (re.sub(r"^(times?stamp|times?)", "", names[time_at].lower())) else 1.0
        clock = [scale * time for time in clock]
    if len(there) > 1 and time_at is not None:
        found, full = fill_missing_frames(path, np.asarray(clock), there, f"column '{names[time_at]}'")
    elif len(there) > 1 and frame_at is not None:
        _, full = fill_missing_frames(path, np.asarray(numbers), there, f"column '{names[frame_at]}'")
    # the rate of a single frame is arbitrary
    rate = rate or said or found or (1.0 if len(there) == 1 else None)
    if len(there) and rate is None:
        raise InputError(
            f"{path}: the frame rate is unknown; add a column 'time' in seconds, or a first line such as "
            "'# rate: 120'."
        )
    missing = len(full) - len(there)
    messages = (
        [f"{missing} frames are missing between its rows; no marker is visible in them."] if missing else []
    )
    first = round(numbers[0]) if numbers else 1
    return make_marker_file(
        path,
        full,
        labels,
        rate or 1.0,
        "m" if unit is None else unit,
        first_frame=first,
        warnings=messages,
        start=clock[0] if clock else None,
    )


def write_marker_table(path: str | Path, frames: MarkerFrames, unit: str | float = "m") -> None:
    """Write markers or joint centres as CSV with columns `time, LKNE.x, LKNE.y, LKNE.z, ...`.

    A gap is three empty cells.

    A single frame, which does not determine the rate, gets a line `# rate: 120` above.

    **Raises:** `InputError` if the file cannot be written.
    """
    positions, seen = shift_from_origin(frames)
    positions = positions / unit_scale(unit)
    text = io.StringIO()
    if len(frames) == 1:
        text.write(f"# rate: {frames.rate:.9g}\n")
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["time", *(f"{label}.{axis}" for label in frames.labels for axis in "xyz")])
    for number, (row, there) in enumerate(zip(positions, seen, strict=True)):
        cells = [
            f"{x:.9g}" if is_seen else "" for place, is_seen in zip(row, there, strict=True) for x in place
        ]
        writer.writerow([f"{number / frames.rate:.12g}", *cells])
    write_text(path, text.getvalue())


def _rows(path: Path, text: str) -> tuple[float | None, list[tuple[int, list[str]]]]:
    """Return the rate from a line before the table, and the rows with their line numbers."""
    rate, lines = None, text.splitlines(keepends=True)
    start = len(lines)
    for i, line in enumerate(lines):
        match = _RATE_LINE.fullmatch(_collapse_blanks(line)) if len(line) <= LONGEST_NAME else None
        if match:
            (rate,) = parse_floats([match[2]], f"{path}:{i + 1}", "the rate")
            check_frame_rate(rate, f"{path}:{i + 1}")
        elif line.strip() and not line.lstrip().startswith("# "):
            start = i
            break
    head = lines[start] if start < len(lines) else ""
    mark = max(",;\t", key=head.count)
    reader = csv.reader(io.StringIO("".join(lines[start:]), newline=""), delimiter=mark)
    try:
        rows = [(start + reader.line_num, [cell.strip() for cell in cells]) for cells in reader]
    except csv.Error as error:
        raise InputError(f"{path}:{start + reader.line_num}: this is not a table ({error}).") from None
    return rate, [(number, cells) for number, cells in rows if any(cells)]


def _collapse_blanks(text: str) -> str:
    """Collapse blanks and tabs to single blanks."""
    return " ".join(text.split())


def _column_names(rows: Sequence[tuple[int, list[str]]]) -> tuple[list[str], int]:
    """Return the column names, and the index of the first row of frames."""
    above = rows[0][1]
    below = rows[1][1] if len(rows) > 1 else []
    axes = [cell for cell in below if re.fullmatch(r"[xyzXYZ]\d*", cell)]
    if not axes:
        return above, 1
    names, label = [], ""
    for i, cell in enumerate(below):
        given = above[i] if i < len(above) else ""
        is_axis = bool(re.fullmatch(r"[xyzXYZ]\d*", cell))
        # a label is above the first of its columns, or above all of them
        label = given or (label if is_axis else "")
        names.append(f"{label}.{cell[0]}" if is_axis else given or cell)
    return names, 2


def _markers(path: Path, line: int, names: list[str]) -> tuple[list[str], list[list[int]]]:
    """Return the labels, and for each the indices of its columns x, y and z."""
    found: dict[str, dict[str, int]] = {}
    for i, name in enumerate(names):
        match = _MARKER_COLUMN.fullmatch(name)
        if match and not _TIME_COLUMN.fullmatch(name.lower()):
            axes = found.setdefault(match["label"], {})
            axis = match["axis"].lower()
            if axis in axes:
                raise InputError(
                    f"{path}:{line}: two columns are named '{name}'; give each marker a unique label."
                )
            axes[axis] = i
    if not found:
        raise InputError(
            f"{path}:{line}: the table has no columns of markers; name them as in 'LKNE.x', 'LKNE.y', 'LKNE.z'."
        )
    for label, axes in found.items():
        if lacking := [axis for axis in "xyz" if axis not in axes]:
            raise InputError(
                f"{path}:{line}: marker '{label}' has no column '{label}.{lacking[0]}'; write all three coordinates."
            )
    return list(found), [[axes[axis] for axis in "xyz"] for axes in found.values()]


def _find(pattern: re.Pattern, names: list[str]) -> int | None:
    return next((i for i, name in enumerate(names) if pattern.fullmatch(name.strip().lower())), None)
