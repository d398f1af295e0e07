"""Tables of joint angles with a stated convention: CSV, MATLAB and OpenSim's tables."""

from collections.abc import Mapping
from pathlib import Path
from typing import Literal

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ..arguments import checked
from ..biomechanics.angles import JointAngles
from ..biomechanics.conventions import angle_conventions
from ..errors import InputError
from .kinds import wrong_kind_error
from .matlab import read_matlab
from .opensim.storage import ANGLES_TITLE, SUFFIXES, rate_of_times, read_storage
from .system.reader_errors import reader_of
from .text import check_frame_rate, parse_floats, read_text, shortened

#: conventions of angles: those of `docs/joint_angles.md`, in degrees (`isb` if the numbers look like degrees,
#: `isb-degrees` also if they are tiny) or in radians
AngleUnits = Literal["isb", "isb-degrees", "isb-radians"]
#: suffixes of tables of angles
ANGLE_SUFFIXES = (".csv", ".mat", *SUFFIXES)
#: largest angle of a table in radians; one in degrees has larger ones
MAX_RADIANS = 2 * np.pi + 0.1
#: first line of the tables that `write_angle_table` writes
TITLE = "# joint angles"


@checked
@reader_of("joint angles")
def read_angles(path: str | Path, convention: AngleUnits | None = None) -> JointAngles:
    """Read joint angles over time from `.csv`, `.mat`, `.mot` or `.sto`.

    Tables that `jaxcap convert --as angles` wrote state their convention and unit. Other tables need one: `"isb"` for the angles
    of `docs/joint_angles.md` in degrees, or `"isb-radians"`. A table whose angles are all below 6.4 is refused as `"isb"`,
    because it may be in radians; `"isb-degrees"` reads it in degrees. Columns are found by the names of that page; others
    are not used. CSV files have a column `time` in seconds. MATLAB files have a vector for each angle, at the top or in one
    struct, and `time` or `rate`. The unit in the header of an OpenSim table has to be that of the convention.

    **Raises:** `InputError` if the file is invalid, states no convention and none is given, has no known angle, or its numbers
    contradict the unit.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix == ".csv":
        columns, rate, stated = _read_csv(path)
    elif suffix == ".mat":
        columns, rate, stated = *_read_mat(path), None
    elif suffix in SUFFIXES:
        table = read_storage(path)
        columns, rate = dict(zip(table.names, table.values.T, strict=True)), table.rate
        stated = ("isb" if table.in_degrees else "isb-radians") if table.title == ANGLES_TITLE else None
        if stated is None and convention is not None and table.states_unit:
            stated = _stated_unit(path, table.in_degrees, convention)
    else:
        raise wrong_kind_error(path, "a table of joint angles", ANGLE_SUFFIXES)
    units = stated or convention
    if units is None:
        raise InputError(
            f"{path}: the file does not state the convention of its angles; give --convention isb if they are those of "
            "docs/joint_angles.md in degrees, or isb-radians. Coordinates of an OpenSim model become a motion with "
            "`jaxcap convert` and the model."
        )
    # only numbers without a stated unit are judged by their size
    return _make_angles(path, columns, rate, "isb-degrees" if stated == "isb" else units)


def _stated_unit(path: Path, in_degrees: bool, convention: AngleUnits) -> str:
    """Return the unit of a table's header. Raises `InputError` if that of the convention is another one."""
    unit, stated = ("degrees", "isb") if in_degrees else ("radians", "isb-radians")
    if in_degrees == (convention == "isb-radians"):
        raise InputError(f"{path}: the header says that angles are in {unit}; give --convention {stated}.")
    return stated


def is_angle_table(path: str | Path) -> bool:
    """Test if a file is a table of joint angles by its suffix, or, for CSV files, by its first line."""
    path = Path(path)
    if path.suffix.lower() != ".csv" or not path.is_file():
        return path.suffix.lower() in ANGLE_SUFFIXES[1:]
    with path.open("rb") as file:
        return file.read(len(TITLE)) == TITLE.encode()


def _make_angles(
    path: Path, columns: Mapping[str, Float[np.ndarray, "F"]], rate: float, units: str
) -> JointAngles:
    conventions = tuple(each for each in angle_conventions() if each.name in columns)
    if not conventions:
        known = ", ".join(each.name for each in angle_conventions()[:8])
        raise InputError(
            f"{path}: the columns {shortened(', '.join(columns))} are no joint angles; expected names such as {known}."
        )
    values = np.stack([columns[each.name] for each in conventions], 1)
    if not np.isfinite(values).all():
        raise InputError(f"{path}: an angle is not finite; fill or cut the gaps.")
    largest = float(np.abs(values).max())
    if units == "isb-radians" and largest > MAX_RADIANS:
        raise InputError(
            f"{path}: an angle is {largest:.4g}, which is more than a turn in radians; give --convention isb for degrees."
        )
    if units == "isb" and 0.0 < largest <= MAX_RADIANS and len(values) > 1:
        raise InputError(
            f"{path}: all angles are at most {largest:.3g}, which looks like radians; give --convention isb-radians, or "
            "--convention isb-degrees if they are degrees."
        )
    values = values if units == "isb-radians" else np.radians(values)
    return JointAngles(jnp.asarray(values), conventions, (), check_frame_rate(rate, str(path)))


def _read_csv(path: Path) -> tuple[dict[str, np.ndarray], float, str | None]:
    lines = read_text(path).splitlines()
    stated = "isb" if lines and lines[0].strip() == TITLE else None
    rows = [(n, line) for n, line in enumerate(lines, 1) if line.strip() and not line.startswith("#")]
    if len(rows) < 3:
        raise InputError(
            f"{path}: the table has fewer than two rows; expected a header and a row for each frame."
        )
    names = [name.strip().strip('"') for name in rows[0][1].split(",")]
    if "time" not in names:
        raise InputError(f"{path}:{rows[0][0]}: there is no column 'time'; expected times in seconds.")
    table = []
    for number, line in rows[1:]:
        cells = parse_floats(line.split(","), f"{path}:{number}", "a cell")
        if len(cells) != len(names):
            raise InputError(f"{path}:{number}: the row has {len(cells)} numbers; expected {len(names)}.")
        table.append(cells)
    columns = dict(zip(names, np.array(table).T, strict=True))
    return columns, rate_of_times(columns["time"], path), stated


def _read_mat(path: Path) -> tuple[dict[str, np.ndarray], float]:
    groups = read_matlab(path)
    known = {each.name for each in angle_conventions()}
    named = [name for name, values in groups.items() if known & set(values)]
    if len(named) > 1:
        places = ", ".join(f"the struct '{shortened(name)}'" if name else "the top" for name in named)
        raise InputError(
            f"{path}: there are joint angles in {places}; save those of one motion to a file of their own."
        )
    # the time and the rate may be at the top, next to the struct
    own = groups[""] | (groups[named[0]] if named else {})
    columns = {name: each for name, each in own.items() if each.ndim == 1 and len(each) > 1}
    times = columns.pop("time", None)
    rates = [float(own[name]) for name in ("rate", "fps") if name in own and own[name].ndim == 0]
    if not rates and times is None:
        raise InputError(
            f"{path}: there is neither `time` nor `rate`; add the times of the frames in seconds."
        )
    counts = {len(each) for name, each in columns.items() if name in known}
    if len(counts) > 1:
        raise InputError(f"{path}: the angles have {sorted(counts)} frames; expected one number of frames.")
    if times is not None and counts and len(times) not in counts:
        raise InputError(
            f"{path}: there are {len(times)} times and {counts.pop()} frames; expected one time for each."
        )
    if rates or times is None:
        return columns, rates[0]
    return columns, rate_of_times(times, path)
