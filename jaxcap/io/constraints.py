"""Constraints of inverse kinematics as JSON that a person can read and write.

    {
     "format": "jaxcap constraints",
     "version": 1,
     "vertices": 13380,
     "constraints": [
      {"vertex": 4021, "target": [0.55, 1.2, 0.31]},
      {"joint": "LeftFoot", "target": [0.14, -0.73, 0.02], "weight": 2.0, "pinned": true}
     ]
    }

Targets are in metres. The default of `weight` is 1, that of `pinned` is false. `orientation`, a quaternion
`w, x, y, z`, is for joints. `vertices` is the number of vertices of the body, as vertex indices are valid for
that body only; it may be omitted.
"""

import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from ..arguments import checked
from ..body.body import Body
from ..edit.ik.constraints import Constraint, check_constraints, describe_point
from ..errors import InputError, user_message
from .kinds import check_kind
from .system.atomic import write_text
from .system.reader_errors import reader_of
from .text import read_json, shortened

FORMAT, VERSION = "jaxcap constraints", 1
_FIELDS = ("vertex", "joint", "target", "weight", "pinned", "orientation")


@checked
def write_constraints(path: str | Path, constraints: Sequence[Constraint], body: Body) -> None:
    """Write constraints of a body, every number to the last bit.

    **Raises:** `InputError` if they do not belong to this body, or the file cannot be written.
    """
    _check(constraints, body, path)
    rows = ",\n".join(f"  {json.dumps(_row(constraint))}" for constraint in constraints)
    head = f' "format": "{FORMAT}",\n "version": {VERSION},\n "vertices": {len(body.vertices)},\n'
    write_text(path, f'{{\n{head} "constraints": [\n{rows}\n ]\n}}\n')


@checked
@reader_of("constraints")
def read_constraints(path: str | Path, body: Body) -> tuple[Constraint, ...]:
    """Read constraints that `write_constraints` or a person wrote.

    **Raises:** `InputError` if the file has another format or is damaged, if its body has another number of
    vertices, or if a constraint names a vertex or joint that this body lacks or has another error. The
    message gives the row and the error.
    """
    check_kind(path, "constraints", (".json",))
    content = read_json(path)
    found = content.get("format") if isinstance(content, dict) else None
    if found != FORMAT:
        raise InputError(
            f'{path}: this is not a file of constraints; expected "format": "{FORMAT}" at its beginning.'
        )
    if content.get("version") != VERSION:
        raise InputError(
            f"{path}: this file has version {shortened(repr(content.get('version')))}; expected version {VERSION}."
        )
    rows = content.get("constraints")
    if not isinstance(rows, list):
        raise InputError(f'{path}: the file has no list "constraints"; write a list, which may be empty.')
    constraints = tuple(
        _constraint(row, f"{path}: constraint {number}") for number, row in enumerate(rows, 1)
    )
    count = content.get("vertices", len(body.vertices))
    if not isinstance(count, int):
        raise InputError(
            f'{path}: "vertices" is {shortened(repr(count))}; give the number of vertices of the body.'
        )
    if count != len(body.vertices) and any(not isinstance(one.point, str) for one in constraints):
        raise InputError(
            f"{path}: these constraints belong to a body with {count} vertices, and this body has {len(body.vertices)}; "
            "give the right body."
        )
    _check(constraints, body, path)
    return constraints


def _row(constraint: Constraint) -> dict[str, object]:
    where = "joint" if isinstance(constraint.point, str) else "vertex"
    row: dict[str, object] = {where: constraint.point, "target": list(constraint.target)}
    row |= {"weight": constraint.weight, "pinned": constraint.pinned}
    return row if constraint.orientation is None else {**row, "orientation": list(constraint.orientation)}


def _constraint(row: Any, where: str) -> Constraint:
    if not isinstance(row, dict):
        raise InputError(f'{where}: this is not a constraint; write {{"joint": NAME, "target": [x, y, z]}}.')
    strange = [name for name in row if name not in _FIELDS]
    if strange:
        raise InputError(
            f"{where}: '{shortened(strange[0])}' is unknown; a constraint has {', '.join(_FIELDS)}."
        )
    if ("vertex" in row) == ("joint" in row):
        raise InputError(f'{where}: expected either "vertex" or "joint"; give one of them.')
    point: Any = row.get("joint", row.get("vertex"))
    if "joint" in row and not isinstance(point, str):
        raise InputError(f"{where}: the joint is {shortened(repr(point))}; give its name.")
    if "vertex" in row and (not isinstance(point, int) or isinstance(point, bool)):
        raise InputError(f"{where}: the vertex is {shortened(repr(point))}; give its index, counted from 0.")
    target = _numbers(row, "target", 3, f"{where} ({describe_point(point)})")
    weight, pinned = row.get("weight", 1.0), row.get("pinned", False)
    if not _is_number(weight) or weight < 0:
        raise InputError(
            f"{where} ({describe_point(point)}): the weight is {shortened(repr(weight))}; give a number of at least 0."
        )
    if not isinstance(pinned, bool):
        raise InputError(
            f'{where} ({describe_point(point)}): "pinned" is {shortened(repr(pinned))}; give true or false.'
        )
    orientation = row.get("orientation")
    turn = (
        None if orientation is None else _numbers(row, "orientation", 4, f"{where} ({describe_point(point)})")
    )
    return Constraint(point, target, float(weight), pinned, turn)


def _numbers(row: Mapping[str, Any], name: str, count: int, where: str) -> Any:
    values = row.get(name)
    if not isinstance(values, list) or len(values) != count or not all(map(_is_number, values)):
        raise InputError(
            f'{where}: the "{name}" is {shortened(repr(values))}; give {count} finite numbers in brackets.'
        )
    return tuple(float(value) for value in values)


def _is_number(value: Any) -> bool:
    if isinstance(value, bool) or not isinstance(value, int | float):
        return False
    try:
        return math.isfinite(float(value))
    except OverflowError:
        return False


def _check(constraints: Sequence[Constraint], body: Body, path: str | Path) -> None:
    try:
        check_constraints(constraints, body.skeleton, len(body.vertices))
    except ValueError as error:
        raise InputError(f"{path}: {user_message(error)}") from None
