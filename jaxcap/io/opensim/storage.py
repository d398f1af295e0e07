"""Tables of numbers over time as OpenSim writes them (`.mot`, `.sto`)."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from ...arguments import checked
from ...body.coordinates.coordinate_model import CoordinateModel, motion_from_coordinates
from ...body.pose import Motion
from ...errors import InputError
from ..system.atomic import write_text
from ..system.reader_errors import reader_of
from ..text import check_frame_rate, parse_floats, read_text, shortened

#: suffixes of these tables
SUFFIXES = (".mot", ".sto")
#: largest deviation of a time from equal steps, as a share of a step; times are rounded
TIME_TOLERANCE = 0.25
#: largest distance of a coordinate from its range, radians or metres: tables are rounded
RANGE_TOLERANCE = 1e-3
#: title of a table of joint angles that are no coordinates of a model
ANGLES_TITLE = "Joint angles"


class Storage(NamedTuple):
    """Columns of numbers over time."""

    #: names of the columns without that of time
    names: tuple[str, ...]
    values: Float[np.ndarray, "F C"]
    #: frames per second
    rate: float
    #: time of the first row, seconds
    start: float
    #: true if angles are in degrees
    in_degrees: bool
    #: the first line of the file
    title: str = ""
    #: true if the header states the unit of angles
    states_unit: bool = True


@checked
@reader_of("a table of OpenSim")
def read_storage(path: str | Path) -> Storage:
    """Read a table (`.mot`, `.sto`) with rows at equal steps of time.

    **Raises:** `InputError`, with the line, if the header ends nowhere, a cell is no number, a row has another length, the number
    of rows differs from the header, or times are not at equal steps.
    """
    lines = read_text(path).splitlines()
    end = next((number for number, line in enumerate(lines) if line.strip().lower() == "endheader"), None)
    if end is None:
        raise InputError(f"{path}: there is no line 'endheader'; give a table of OpenSim.")
    settings = {}
    for line in lines[:end]:
        # `name=value`, or the older `name value`
        words = line.replace("=", " ", 1).split(None, 1)
        if words:
            settings[words[0].lower()] = words[1].strip() if len(words) > 1 else ""
    rows = [(number, line) for number, line in enumerate(lines[end + 1 :], end + 2) if line.strip()]
    if len(rows) < 2:
        raise InputError(f"{path}: the table has no rows; export it again.")
    header = rows[0][1].split("\t") if "\t" in rows[0][1] else rows[0][1].split()
    names = [name.strip() for name in header if name.strip()]
    if names[0].lower() != "time":
        raise InputError(
            f"{path}:{rows[0][0]}: the first column is '{shortened(names[0])}'; expected 'time'; export the table again."
        )
    table = []
    for number, line in rows[1:]:
        cells = parse_floats(line.split(), f"{path}:{number}", "a cell")
        if len(cells) != len(names):
            raise InputError(f"{path}:{number}: the row has {len(cells)} numbers; expected {len(names)}.")
        table.append(cells)
    declared = settings.get("nrows", settings.get("datarows", str(len(table))))
    if declared != str(len(table)):
        raise InputError(
            f"{path}: the file has {len(table)} rows, and its header declares {shortened(declared)}; it may be cut short."
        )
    values = np.array(table)
    title = next((line.strip() for line in lines[:end] if line.strip()), "")
    return Storage(
        tuple(names[1:]),
        values[:, 1:],
        rate_of_times(values[:, 0], path),
        float(values[0, 0]),
        _are_degrees(settings, path),
        title,
        "indegrees" in settings,
    )


@checked
def write_storage(
    path: str | Path,
    names: Sequence[str],
    values: Float[np.ndarray, "F C"],
    rate: float,
    *,
    in_degrees: bool,
    start: float = 0.0,
    title: str = "Coordinates",
) -> None:
    """Write a table of numbers over time; lengths are in metres, and angles in degrees where `in_degrees`.

    **Raises:** `InputError` if a name has a blank, or the file cannot be written.
    """
    wrong = [name for name in names if not name or len(name.split()) != 1]
    if wrong:
        raise InputError(
            f"{path}: the column '{wrong[0]}' has a blank in its name; a table of OpenSim cannot have it."
        )
    lines = [
        title,
        "version=1",
        f"nRows={len(values)}",
        f"nColumns={len(names) + 1}",
        f"inDegrees={'yes' if in_degrees else 'no'}",
        "",
        "Units are S.I. units (seconds, metres, Newtons, ...)",
        f"Angles are in {'degrees' if in_degrees else 'radians'}.",
        "",
        "endheader",
        "\t".join(["time", *names]),
    ]
    for number, row in enumerate(values):
        cells = [f"{start + number / rate:.8f}", *(f"{cell:.10g}" for cell in row)]
        lines.append("\t".join(cells))
    write_text(path, "\n".join(lines) + "\n")


@checked
def read_coordinates(path: str | Path, model: CoordinateModel) -> tuple[Float[np.ndarray, "F Q"], Motion]:
    """Read the coordinates of a model over time, radians and metres, and the motion that they make.

    Locked coordinates that the table does not have keep their default values, and those that follow others have the values of
    their functions; other columns, such as forces, are not used. Names may be paths, as in
    `/jointset/hip_r/hip_flexion_r/value`.

    **Raises:** `InputError` as `read_storage`, and if the table lacks a free coordinate of the model, or has joint angles of
    `write_angles`, whose signs may be others.
    """
    table = read_storage(path)
    columns = {_coordinate_name(name): number for number, name in enumerate(table.names)}
    if not set(columns) & set(model.names):
        raise InputError(
            f"{path}: none of the columns ({', '.join(table.names[:5])}, ...) is a coordinate of the model "
            f"({', '.join(model.names[:5])}, ...); give the model of this motion."
        )
    missing = [model.names[number] for number in model.free if model.names[number] not in columns]
    if missing:
        raise InputError(
            f"{path}: the table lacks {len(missing)} coordinates of the model, {', '.join(missing[:5])}; give the table of this model."
        )
    if table.title == ANGLES_TITLE:
        raise InputError(
            f"{path}: these are joint angles by ISB's conventions, and no coordinates of a model, which may have other signs."
        )
    values = np.tile(np.asarray(model.defaults, float), (len(table.values), 1))
    for number, coordinate in enumerate(model.coordinates):
        if coordinate.name in columns:
            column = table.values[:, columns[coordinate.name]]
            values[:, number] = np.radians(column) if coordinate.is_angle and table.in_degrees else column
    return values, motion_from_coordinates(model, values, table.rate)


def find_outside(model: CoordinateModel, values: Float[np.ndarray, "F Q"]) -> list[str]:
    """Find the names of clamped coordinates that leave their ranges, beyond rounding."""
    low, high = (np.asarray(bound, float) for bound in model.bounds)
    outside = ((values < low - RANGE_TOLERANCE) | (values > high + RANGE_TOLERANCE)).any(0)
    return [model.names[number] for number in np.flatnonzero(outside)]


@checked
def write_coordinates(
    path: str | Path,
    model: CoordinateModel,
    values: Float[np.ndarray, "F Q"],
    rate: float,
    *,
    start: float = 0.0,
) -> None:
    """Write the coordinates of a model over time, angles in degrees; raises `InputError` as `write_storage`.

    `values` are in radians and metres.
    """
    angles = np.array([coordinate.is_angle for coordinate in model.coordinates])
    shown = np.where(angles, np.degrees(values), values)
    write_storage(path, model.names, shown, rate, in_degrees=True, start=start)


def _coordinate_name(column: str) -> str:
    """Find the coordinate of a column; a path ends in the kind of value."""
    parts = column.split("/")
    return parts[-2] if len(parts) > 1 and parts[-1] == "value" else parts[-1]


def _are_degrees(settings: Mapping[str, str], path: str | Path) -> bool:
    """Read the unit of angles as OpenSim does: the older header of SIMM, which does not state it, has degrees."""
    word = settings.get("indegrees", "yes" if "datacolumns" in settings else "no").lower()
    if word not in ("yes", "y", "true", "1", "no", "n", "false", "0"):
        raise InputError(f"{path}: inDegrees is '{shortened(word)}'; expected yes or no.")
    return word in ("yes", "y", "true", "1")


def rate_of_times(times: Float[np.ndarray, "F"], path: str | Path) -> float:
    """Compute the rate of equal steps of time. Raises `InputError` if they are not equal."""
    if len(times) == 1:
        return 30.0
    step = (times[-1] - times[0]) / (len(times) - 1)
    if (
        not step > 1e-9
        or np.abs(times - times[0] - step * np.arange(len(times))).max() > TIME_TOLERANCE * step
    ):
        raise InputError(f"{path}: the times are not at equal steps; resample the table.")
    return check_frame_rate(1.0 / step, str(path))
