"""Kineben joint limits (`.cst`), read and written (Kineben, appendix A.5).

    KBCST 2
    knee -0.1 2.4
    hip  0 -1 0 1.2  1 0 0 0.6

The number of entries comes first. An entry is, for a revolute joint, its smallest and largest angle; for a
ball joint, its heading axis, the largest angle from it, its bank axis, and the largest angle from that; for a
translate joint, three numbers that the paper does not explain and that are kept unchanged. A universal joint,
our own, has two pairs of angles. Joints may be omitted. The paper does not give the unit of the angles
either: they are radians unless `angle_unit="deg"`.
"""

from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np

from ...arguments import checked
from ...body.skeleton import Skeleton
from ...errors import InputError, user_message
from ...limits.ranges_and_cones import Cone, JointRanges, make_joint_ranges
from ..kinds import check_kind
from ..system.atomic import write_text
from ..system.reader_errors import reader_of
from ..text import Words, shortened

_NUM_VALUES = {"translate": 3, "revolute": 2, "universal": 4, "ball": 8, "free": 8}


class CstLimits(NamedTuple):
    """The contents of a `.cst` file."""

    ranges: JointRanges
    #: the three numbers of each translate joint, unchanged
    translations: dict[str, tuple[float, float, float]] = {}  # noqa: RUF012


@checked
@reader_of("joint limits")
def read_cst(path: str | Path, skeleton: Skeleton, angle_unit: Literal["rad", "deg"] = "rad") -> CstLimits:
    """Read the limits of a skeleton's joints.

    **Raises:** `InputError` with file and line, for an unknown or duplicate joint, a smallest angle above the
    largest, an invalid cone, or missing numbers.
    """
    check_kind(path, "cst", (".cst",))
    words, turn = Words(path), _radians(angle_unit)
    count = words.header("KBCST")
    if count < 0:
        raise InputError(
            f"{words.where}: the header declares {count} joints; expected a number of at least 0."
        )
    seen: set[str] = set()
    ranges, cones, translations = {}, {}, {}
    for _ in range(count):
        name = words.take(f"one of the {count} joints of the header")
        where = words.where
        if name not in skeleton.names:
            raise InputError(
                f"{where}: '{shortened(name)}' is not a joint of the skeleton, which has {', '.join(skeleton.names)}; write limits of these joints."
            )
        if name in seen:
            raise InputError(f"{where}: the joint '{name}' occurs twice; remove one of its entries.")
        seen.add(name)
        kind = skeleton.kinds[skeleton.index(name)]
        if kind not in _NUM_VALUES:
            raise InputError(f"{where}: the joint '{name}' is {kind} and has no range; remove it.")
        v = words.floats(_NUM_VALUES[kind], f"the limits of the {kind} joint '{name}'")
        try:
            if kind == "translate":
                translations[name] = (v[0], v[1], v[2])
            elif kind in ("revolute", "universal"):
                ranges[name] = (np.array(v).reshape(-1, 2) * turn).tolist()
                make_joint_ranges(skeleton, {name: ranges[name]})
            else:
                cones[name] = Cone((v[0], v[1], v[2]), v[3] * turn, (v[4], v[5], v[6]), v[7] * turn)
                make_joint_ranges(skeleton, None, {name: cones[name]})
        except ValueError as error:
            raise InputError(f"{where}: {user_message(error)}") from None
    if words.left:
        extra = words.take("")
        raise InputError(
            f"{words.where}: found '{shortened(extra)}' after the {count} joints of the header; correct the number in the header."
        )
    return CstLimits(make_joint_ranges(skeleton, ranges, cones), translations)


@checked
def write_cst(
    path: str | Path, skeleton: Skeleton, constraints: CstLimits, angle_unit: Literal["rad", "deg"] = "rad"
) -> None:
    """Write the limits of a skeleton's joints. Raises `InputError` if the file cannot be written."""
    ranges, turn = constraints.ranges, _radians(angle_unit)
    rows: dict[str, list] = {name: list(values) for name, values in constraints.translations.items()}
    order = np.lexsort((np.asarray(ranges.angle_indices), np.asarray(ranges.joints)))
    for i in order:
        row = rows.setdefault(skeleton.names[int(ranges.joints[i])], [])
        row += [float(ranges.lower[i]) / turn, float(ranges.upper[i]) / turn]
    for i, joint in enumerate(np.asarray(ranges.ball_joints)):
        heading, bank = np.asarray(ranges.heading[i], float), np.asarray(ranges.bank[i], float)
        angles = float(ranges.heading_angle[i]) / turn, float(ranges.bank_angle[i]) / turn
        rows[skeleton.names[joint]] = [*heading, angles[0], *bank, angles[1]]
    lines = [" ".join([name, *(f"{value:.9g}" for value in row)]) for name, row in rows.items()]
    write_text(path, "\n".join([f"KBCST {len(rows)}", *lines]) + "\n")


def _radians(angle_unit: str) -> float:
    if angle_unit not in ("rad", "deg"):
        raise InputError(f"'{angle_unit}' is not a unit of angles; give 'rad' or 'deg'.")
    return 1.0 if angle_unit == "rad" else np.pi / 180
