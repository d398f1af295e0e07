"""TRC, the tables of marker trajectories of Motion Analysis and OpenSim.

Five header lines (type, names of settings, settings, labels, axes), then a row for each frame: its number,
its time, and three numbers for each marker. Empty cells are gaps.
"""

import math
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ...errors import InputError
from ...observe.markers import MarkerFrames
from ...units import UNITS, unit_scale
from ..system.atomic import write_text
from ..system.reader_errors import reader_of
from ..text import check_frame_rate, parse_floats, parse_int, read_text, shortened
from .marker_file import MarkerFile, fill_missing_frames, make_marker_file, parse_unit, shift_from_origin

#: cells that are allowed in a file of any size
MAX_CELLS = 1_000_000
#: number of lines in a sentence
MAX_LISTED = 8
#: largest share of rows with a wrong number of cells
MAX_DAMAGED = 0.1


class _TrcHeader(NamedTuple):
    rate: float
    #: frames and markers that the header announces, or None
    frames: int | None
    markers: int | None
    unit: str
    labels: list[str]


@reader_of("a TRC file")
def read_trc(path: str | Path, unit: str | float | None = None) -> MarkerFile:
    """Read the markers of a TRC file; a cell that is empty or NaN, or a position of zeros, is a gap.

    Cells are separated by tabs or blanks, or by commas or semicolons, as spreadsheets save them.

    **Arguments:** `unit` of lengths, which overrides that of the header; the default without both is
    millimetres.

    Cells beyond the markers of the header are left out, and a row in which they are no whole points shows no marker; both are
    reported in the warnings of the file, and so is a wrong number of frames in the header.

    **Raises:** `InputError`, with the line, if there is no such file, it is no TRC file or cut short within its header or a row,
    a cell is no number, more than a tenth of the rows have a wrong number of cells, or it has no markers or no frames.
    """
    path = Path(path)
    lines = _with_tabs(read_text(path).splitlines())
    if not any(line.strip() for line in lines):
        raise InputError(f"{path}: the file is empty; copy or export it again.")
    head = _read_head(path, lines)
    count, numbers, times, rows = len(head.labels), [], [], []
    # lines of rows with further points, and of rows whose cells belong to no marker
    longer, uneven = [], []
    # empty cells may be missing, so a small file could claim many
    room = max(MAX_CELLS, 8 * sum(map(len, lines)))
    for number, line in enumerate(lines[5:], 6):
        if not line.strip():
            continue
        where = f"{path}:{number}"
        cells = [cell.strip() for cell in line.split("\t")] if "\t" in line else line.split()
        width = max((i + 1 for i, cell in enumerate(cells) if cell), default=0) - 2
        if width > 3 * count:
            # cells that are no whole points may have shifted all others
            (longer if width % 3 == 0 else uneven).append(number)
            cells = cells if width % 3 == 0 else cells[:2]
        if len(rows) * 3 * count > room:
            raise InputError(
                f"{where}: the header declares {3 * count} cells in each row, but most are missing; correct the header."
            )
        # editors remove trailing blanks, so empty cells at the end of a row may be missing
        cells = (cells + [""] * (2 + 3 * count))[: 2 + 3 * count]
        numbers.append(parse_int(cells[0], where, "the frame"))
        times.append(parse_cell(cells[1], where, "the time"))
        rows.append(np.array(parse_positions(cells[2:], head.labels, where)))
    if count and len(uneven) > MAX_DAMAGED * len(rows):
        raise InputError(
            f"{path}:{uneven[0]}: this row, and {len(uneven) - 1} more, have more cells than {count} markers, in no whole points; "
            "correct the header."
        )
    positions = np.asarray(rows, float).reshape(len(rows), count, 3)
    messages = _describe_rows(count, longer, uneven)
    if head.frames not in (None, len(rows)):
        cut = "; it may be cut short" if len(rows) < head.frames else ""
        messages.append(f"the file has {len(rows)} frames; its header declares {head.frames}{cut}.")
    rate = head.rate
    if len(rows) > 1:
        at = np.asarray(numbers, float)
        _, positions = fill_missing_frames(path, at, positions, "the column of frames")
        if len(positions) > len(rows):
            messages.append(
                f"{len(positions) - len(rows)} frames are missing between its rows; no marker is visible in them."
            )
        if not rate > 0 and np.isfinite(times).all():
            rate, _ = fill_missing_frames(
                path, np.asarray(times), np.zeros((len(rows), 0, 3)), "the column of times"
            )
    unit = parse_unit(head.unit) if unit is None else unit
    first = numbers[0] if numbers else 1
    start = times[0] if times and math.isfinite(times[0]) else None
    return make_marker_file(
        path, positions, head.labels, rate, unit, first_frame=first, warnings=messages, start=start
    )


def _with_tabs(lines: list[str]) -> list[str]:
    """Replace the separators of a table that a spreadsheet saved, commas or semicolons, by tabs."""
    if lines and lines[0].startswith("PathFileType,"):
        return [line.replace(",", "\t") for line in lines]
    if lines and lines[0].startswith("PathFileType;"):
        return [line.replace(",", ".").replace(";", "\t") for line in lines]
    return lines


def _describe_rows(count: int, longer: list[int], uneven: list[int]) -> list[str]:
    """Describe rows with more cells than the header, by their lines."""
    messages = []
    if longer:
        messages.append(
            f"{len(longer)} rows have points beyond the {count} markers of the header, the first in line {longer[0]}; these "
            "points are left out."
        )
    if uneven:
        lines = ", ".join(map(str, uneven[:MAX_LISTED])) + (", ..." if len(uneven) > MAX_LISTED else "")
        messages.append(
            f"{len(uneven)} rows have more cells than the {count} markers of the header, in no whole points, in lines {lines}; no "
            "marker is visible in them."
        )
    return messages


def write_trc(path: str | Path, frames: MarkerFrames, unit: str | float = "mm") -> None:
    """Write markers or joint centres as TRC; `unit` is a name, as the header holds a word. Gaps are empty.

    **Raises:** `InputError` if the file cannot be written, or a label holds a tab or a line break.
    """
    path = Path(path)
    if unit not in UNITS:
        raise InputError(
            f"{path}: {unit!r} cannot be the unit of a TRC file; give one of {', '.join(UNITS)}."
        )
    wrong = [label for label in frames.labels if set(label) & set("\t\r\n\v\f\x1c\x1d\x1e\x85\u2028\u2029")]
    if wrong:
        raise InputError(
            f"{path}: the label {wrong[0]!r} contains a tab or a line break, which TRC files cannot represent; change it."
        )
    positions, seen = shift_from_origin(frames)
    count, rate = len(frames.labels), f"{frames.rate:.9g}"
    settings = ("DataRate", "CameraRate", "NumFrames", "NumMarkers", "Units", "OrigDataRate", "OrigDataStartFrame",
                "OrigNumFrames")  # fmt: skip
    values = (rate, rate, len(frames), count, unit, rate, 1, len(frames))
    lines = [
        f"PathFileType\t4\t(X/Y/Z)\t{path.name}",
        "\t".join(settings),
        "\t".join(str(value) for value in values),
        "\t".join(["Frame#", "Time", *(cell for label in frames.labels for cell in (label, "", ""))]),
        "\t".join(["", "", *(f"{axis}{i + 1}" for i in range(count) for axis in "XYZ")]),
        "",
    ]
    positions = positions / unit_scale(unit)
    for number, (row, there) in enumerate(zip(positions, seen, strict=True)):
        cells = [
            f"{x:.9g}" if is_seen else "" for place, is_seen in zip(row, there, strict=True) for x in place
        ]
        lines.append("\t".join([str(number + 1), f"{number / frames.rate:.9g}", *cells]))
    write_text(path, "\n".join(lines) + "\n")


def parse_cell(cell: str, where: str, what: str) -> float:
    """Parse a number; NaN for a cell that is empty or marked as missing."""
    if not cell or cell.lower() in ("nan", "na", "n/a", "null", "none", "-nan", "-nan(ind)", "nan(ind)"):
        return math.nan
    return parse_floats([cell], where, what)[0]


def parse_positions(cells: list[str], labels: list[str], where: str) -> list[float]:
    """Parse three numbers for each label; all NaN for a marker without any.

    **Raises:** `InputError` if a marker has one or two of three coordinates, or a cell is no number.
    """
    numbers = [parse_cell(cell, where, f"marker {shortened(labels[i // 3])}") for i, cell in enumerate(cells)]
    for i, label in enumerate(labels):
        missing = sum(map(math.isnan, numbers[3 * i : 3 * i + 3]))
        if missing in (1, 2):
            raise InputError(
                f"{where}: marker '{shortened(label)}' has {3 - missing} of three coordinates; the row is damaged or cut short."
            )
    return numbers


def _read_head(path: Path, lines: list[str]) -> _TrcHeader:
    if not lines or not lines[0].strip().startswith("PathFileType"):
        raise InputError(
            f"{path}:1: this is not a TRC file; expected PathFileType at the beginning of the first line."
        )
    if len(lines) < 5:
        raise InputError(f"{path}:{len(lines)}: the file is cut short within the five lines of its header.")
    values = dict(zip(lines[1].split(), lines[2].split(), strict=False))

    def setting(name: str) -> int | None:
        return parse_int(values[name], f"{path}:3", name) if name in values else None

    markers = setting("NumMarkers")
    # every marker has a label, axes, or cells
    most = max(map(len, lines))
    if markers is not None and not 0 <= markers <= most:
        raise InputError(
            f"{path}:3: NumMarkers is {markers}, but no line of the file has so many cells; correct the number."
        )
    rate = parse_floats([values["DataRate"]], f"{path}:3", "DataRate")[0] if "DataRate" in values else 0.0
    if rate:
        check_frame_rate(rate, f"{path}:3")
    cells = lines[3].split("\t")
    if "\t" in lines[3]:
        # every third cell; a marker without a name leaves its cell empty
        axes = sum(bool(cell.strip()) for cell in lines[4].split("\t"))
        count = markers if markers is not None else axes // 3
        labels = [cell.strip() for cell in cells[2 : 2 + 3 * count : 3]]
        packed = [cell.strip() for cell in cells[2:] if cell.strip()]
        # some programs write one tab between labels
        labels = packed if len(packed) > sum(map(bool, labels)) and len(packed) == count else labels
    else:
        labels = cells[0].split()[2:]
    if markers is not None and len(labels) > markers:
        raise InputError(
            f"{path}:4: there are {len(labels)} labels for {markers} markers; correct the header."
        )
    extra = 0 if "\t" not in lines[3] else sum(bool(cell.strip()) for cell in cells[2:]) - len(labels)
    if extra > 0:
        raise InputError(
            f"{path}:4: there are {len(labels) + extra} labels for {len(labels)} markers; correct the header."
        )
    labels += [""] * ((markers or 0) - len(labels))
    return _TrcHeader(rate, setting("NumFrames"), markers, values.get("Units", ""), labels)
