"""Joint angles as CSV, with comments that describe each angle, and as tables of OpenSim, in degrees."""

import io
from pathlib import Path

import numpy as np

from ..biomechanics.angles import JointAngles
from ..biomechanics.conventions import WORLD, AngleConvention
from ..errors import InputError
from .opensim.storage import ANGLES_TITLE, write_storage
from .system.atomic import write_text
from .system.reader_errors import reader_of

#: the first comment of a table
TITLE = "joint angles"
#: characters of a line that are read, more than those of the names of all angles
_LONGEST_LINE = 100_000


@reader_of("a table of joint angles")
def read_angle_names(path: str | Path) -> tuple[str, ...] | None:
    """Return the names of the angles in a CSV that `write_angle_table` wrote, None for another file. Raises `InputError`."""
    with open(path, encoding="utf-8", errors="replace") as file:
        lines = iter(lambda: file.readline(_LONGEST_LINE), "")
        if next(lines, "").strip() != f"# {TITLE}":
            return None
        head = next((line for line in lines if not line.startswith("#")), "")
    return tuple(head.strip().split(",")[1:])


def write_angle_table(path: str | Path, angles: JointAngles, start: float = 0.0) -> None:
    """Write joint angles as CSV, in degrees, with a column `time` in seconds from `start`.

    Lines that begin with `#` state the unit, and for each angle its segments, the order of rotations, the axis, the
    positive direction and the source: `pandas.read_csv(path, comment="#")` skips them.

    **Raises:** `InputError` if the file cannot be written.
    """
    values = np.asarray(angles.to_degrees().values, float)
    text = io.StringIO()
    lines = [
        TITLE,
        "angles in degrees, time in seconds; intrinsic rotations from the first segment to the second, between axes "
        "X forward, Y up, Z to the right; left sides are mirrored",
        *(f"{each.name}: {describe_angle(each)}" for each in angles.conventions),
    ]
    missing = angles.describe_missing()
    for line in (*lines, *([] if missing is None else [missing])):
        text.write(f"# {line}\n")
    text.write(",".join(("time", *angles.names)) + "\n")
    times = start + np.arange(len(values)) / check_motion(path, angles)
    np.savetxt(text, np.column_stack([times, values]), fmt="%.9g", delimiter=",")
    write_text(path, text.getvalue())


def write_angle_storage(path: str | Path, angles: JointAngles, start: float = 0.0) -> None:
    """Write joint angles as a table of OpenSim (`.mot`, `.sto`), in degrees. Raises `InputError` if the file cannot be written.

    The names are those of OpenSim's models, and the conventions are those of `angles`: a model of OpenSim may have other signs.
    """
    values = np.asarray(angles.to_degrees().values, float)
    rate = check_motion(path, angles)
    write_storage(path, angles.names, values, rate, in_degrees=True, start=start, title=ANGLES_TITLE)


def describe_angle(convention: AngleConvention) -> str:
    """Describe an angle in one line: segments, order, axis, positive direction and source."""
    first = "the world" if convention.proximal == WORLD else convention.proximal
    return (
        f"{first} to {convention.distal}, order {'-'.join(convention.order.upper())}, rotation {convention.position + 1} "
        f"about {convention.axis}, positive: {convention.positive} ({convention.source})"
    )


def check_motion(path: str | Path, angles: JointAngles) -> float:
    """Return the rate of the angles of a motion. Raises `InputError` for those of a single pose."""
    if angles.rate is None or angles.values.ndim != 2:
        raise InputError(
            f"{path}: these are the joint angles of poses without a rate; give those of a motion, such as "
            "joint_angles(skeleton, stack_poses([pose], 30.0))."
        )
    return angles.rate
