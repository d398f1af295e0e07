"""Kineben skeletons (`.skl`), read and written (Kineben, appendix A.4).

    KBSKEL 3
    hips  TRANSLATE  NULL
    spine BALL       hips
    knee  REVOLUTE   spine
    hips  0 1 0
    spine 0 1 0
    knee  1 0 0  0.1 0.5 0

The number of joints comes first, then each joint's name, type and parent, then each one's coordinates. The
paper does not specify the order of the six numbers of a revolute joint: here they are the axis, of unit
length, and then a point on it. Three types are our own: `UNIVERSAL` (first axis, second axis, point), `FIXED`
and `FREE` (point). Types may be in lower case and begin with `KBJOINT_`.
"""

from pathlib import Path

import numpy as np

from ...arguments import checked
from ...body.skeleton import Skeleton, make_skeleton
from ...errors import InputError
from ...units import unit_scale
from ..system.atomic import write_text
from ..system.reader_errors import reader_of
from ..text import Words, shortened
from .twist_axes import with_twist_axes

#: largest number of letters of a joint's name
LONGEST_NAME = 200
#: number of axes before the point, for each type
NUM_AXES: dict[str, int] = {"TRANSLATE": 0, "REVOLUTE": 1, "BALL": 0, "UNIVERSAL": 2, "FIXED": 0, "FREE": 0}


@checked
@reader_of("a skeleton")
def read_skl(path: str | Path, unit: str | float = "m") -> Skeleton:
    """Read a skeleton; `unit` is that of the file's positions.

    **Raises:** `InputError` with file and line, for an unknown type or parent, a cycle, a duplicate name, or
    coordinates that are missing or not numbers.
    """
    words, metres = Words(path), unit_scale(unit)
    count = words.header("KBSKEL")
    if count < 1:
        raise InputError(f"{words.where}: the header declares {count} joints; expected at least one.")
    names: list[str] = []
    kinds, above, lines = {}, {}, {}
    for _ in range(count):
        name = words.take(f"one of the {count} joints of the header")
        if len(name) > LONGEST_NAME:
            raise InputError(
                f"{words.where}: the joint '{shortened(name)}' has a name of {len(name)} characters; expected at most {LONGEST_NAME}."
            )
        if name in lines:
            raise InputError(
                f"{words.where}: the joint '{shortened(name)}' occurs twice; names must be unique."
            )
        lines[name] = words.where
        kind = words.take(f"the type of '{name}'").upper().removeprefix("KBJOINT_")
        if kind not in NUM_AXES:
            raise InputError(
                f"{words.where}: '{shortened(kind)}' is not a joint type; expected {', '.join(NUM_AXES)}."
            )
        names.append(name)
        kinds[name], above[name] = kind, words.take(f"the parent of '{name}'")
    _check_tree(above, lines)
    centres, axes = {}, {}
    while words.left:
        name = words.take("a joint")
        if name not in kinds:
            raise InputError(
                f"{words.where}: '{shortened(name)}' is not a joint of this file; expected the coordinates of a joint."
            )
        if name in centres:
            raise InputError(
                f"{words.where}: the coordinates of '{name}' occur twice; remove one of the lines."
            )
        number = NUM_AXES[kinds[name]]
        values = words.floats(3 * number + 3, f"the coordinates of the {kinds[name]} joint '{name}'")
        axes[name] = _complete_axes(np.array(values[:-3]).reshape(number, 3), values[-3:], name, words.where)
        centres[name] = np.array(values[-3:]) * metres
    for name in names:
        if name not in centres:
            raise InputError(f"{lines[name]}: the joint '{name}' has no coordinates; add a line with them.")
    place = {name: joint for joint, name in enumerate(names)}
    skeleton = make_skeleton(
        names,
        [place.get(above[name], -1) for name in names],
        [kinds[name].lower() for name in names],
        [centres[name] for name in names],
        axes=[axes[name] for name in names],
    )
    return with_twist_axes(skeleton)


def _check_tree(parents: dict[str, str], lines: dict[str, str]) -> None:
    """Check that every joint descends from a root, which has the parent `NULL`.

    Raises `InputError` with the line.
    """
    rooted: set[str] = set()
    for name in parents:
        chain: dict[str, None] = {}
        here = name
        while here != "NULL" and here not in rooted:
            if here in chain:
                joints = list(chain)
                cycle = [*joints[joints.index(here) :], here]
                raise InputError(
                    f"{lines[here]}: the joint '{here}' descends from itself: {shortened(' <- '.join(cycle))}; correct its parent."
                )
            chain[here] = None
            if parents[here] != "NULL" and parents[here] not in parents:
                raise InputError(
                    f"{lines[here]}: the parent '{shortened(parents[here])}' of '{here}' is not a joint of this file; correct it."
                )
            here = parents[here]
        rooted.update(chain)


@checked
def write_skl(path: str | Path, skeleton: Skeleton, unit: str | float = "m") -> None:
    """Write a skeleton; its orientations are not stored, as the reader derives them from the tree.

    **Raises:** `InputError` if a name has blanks or a `#`, or is `NULL`, or the file cannot be written.
    """
    metres = unit_scale(unit)
    for name in skeleton.names:
        if len(name.split()) != 1 or name == "NULL" or "#" in name:
            raise InputError(
                f"{path}: the joint name '{name}' cannot be written to .skl; use one word without '#', other than NULL."
            )
    graph, coordinates = [], []
    for joint, name in enumerate(skeleton.names):
        kind, parent = skeleton.kinds[joint].upper(), skeleton.parents[joint]
        graph.append(f"{name} {kind} {skeleton.names[parent] if parent >= 0 else 'NULL'}")
        axes = np.asarray(skeleton.axes[joint], float)[: NUM_AXES[kind]].ravel()
        place = np.asarray(skeleton.centres[joint], float) / metres
        coordinates.append(" ".join([name, *(f"{value:.9g}" for value in (*axes, *place))]))
    write_text(path, "\n".join([f"KBSKEL {skeleton.num_joints}", *graph, *coordinates]) + "\n")


def _complete_axes(file_axes: np.ndarray, point: list[float], name: str, where: str) -> np.ndarray:
    """Return (2, 3) axes, with defaults for those that the file does not give. Raises `InputError`."""
    lengths = np.linalg.norm(file_axes, axis=1)
    if (np.abs(lengths - 1) > 1e-2).any():
        swapped = abs(np.linalg.norm(point) - 1) < 1e-3
        hint = (
            "the point seems to come before the axis; write the axis first"
            if swapped
            else "expected the length 1"
        )
        raise InputError(
            f"{where}: an axis of '{name}' has the length {lengths[np.argmax(abs(lengths - 1))]:.4g}; {hint}."
        )
    axes = np.eye(3)[:2]
    axes[: len(file_axes)] = file_axes
    if len(file_axes) == 1:
        # any direction other than the axis
        axes[1] = np.roll(np.eye(3), 1, 0)[np.abs(file_axes[0]).argmax()]
    return axes
