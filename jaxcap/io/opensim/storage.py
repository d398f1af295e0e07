"""Tables of numbers over time as OpenSim writes them (`.mot`, `.sto`)."""

from collections.abc import Sequence
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
#: largest deviation of a time from equal steps, as a share of a step
TIME_TOLERANCE = 0.1


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
    settings = dict(line.split("=", 1) for line in lines[:end] if "=" in line)
    settings = {name.strip().lower(): value.strip() for name, value in settings.items()}
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
    in_degrees = settings.get("indegrees", "no").lower() in ("yes", "true", "1")
    return Storage(
        tuple(names[1:]), values[:, 1:], _rate(values[:, 0], path), float(values[0, 0]), in_degrees
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

    Coordinates that the table does not have keep their default values; other columns, such as forces, are not used. Names may
    be paths, as in `/jointset/hip_r/hip_flexion_r/value`.

    **Raises:** `InputError` as `read_storage`, and if the table has no coordinate of the model.
    """
    table = read_storage(path)
    columns = {_coordinate_name(name): number for number, name in enumerate(table.names)}
    if not set(columns) & set(model.names):
        raise InputError(
            f"{path}: none of the columns ({', '.join(table.names[:5])}, ...) is a coordinate of the model "
            f"({', '.join(model.names[:5])}, ...); give the model of this motion."
        )
    values = np.tile(model.defaults, (len(table.values), 1))
    for number, coordinate in enumerate(model.coordinates):
        if coordinate.name in columns:
            column = table.values[:, columns[coordinate.name]]
            values[:, number] = np.radians(column) if coordinate.is_angle and table.in_degrees else column
    return values, motion_from_coordinates(model, values, table.rate)


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


def _rate(times: Float[np.ndarray, "F"], path: str | Path) -> float:
    if len(times) == 1:
        return 30.0
    step = (times[-1] - times[0]) / (len(times) - 1)
    if not step > 0 or np.abs(np.diff(times) / step - 1).max() > TIME_TOLERANCE:
        raise InputError(f"{path}: the times are not at equal steps; resample the table.")
    return check_frame_rate(1.0 / step, str(path))
