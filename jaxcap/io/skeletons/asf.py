"""Acclaim skeletons (`.asf`) and their motions (`.amc`), read.

A bone's motion is given in the bone's own `axis` frame `C`: its local transform is `L = C M C^-1 B`, with `M`
the product of the rotations about its `dof` axes, the first listed applied first, and `B` the step along its
parent. The joint of a bone is at the bone's start, which is its parent's end, so `C M C^-1` is also the
joint's rotation in the rest frame of the world.
"""

import math
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from ...arguments import checked
from ...body.skeleton import Skeleton, make_skeleton
from ...errors import InputError
from ...limits.euler_boxes import EulerBox, EulerBoxes, make_euler_boxes
from ...limits.ranges_and_cones import JointRanges, make_joint_ranges
from ..system.reader_errors import reader_of
from ..text import numbered_lines, parse_floats, read_text, shortened
from .twist_axes import END_SUFFIX, twist_orientations

_KINDS = ("fixed", "revolute", "universal", "ball")


class Asf(NamedTuple):
    """The contents of an `.asf` file. Dictionaries are by bone; angles are in radians, lengths in metres."""

    #: bones as joints; the root is `free`, and every leaf bone has an end, `<bone>.end`
    skeleton: Skeleton
    #: the degrees of freedom of each bone, in the file's order, such as `("rx", "rz")`
    dofs: dict[str, tuple[str, ...]]
    #: (3, 3) the rotation `C` of each bone's own frame
    frames: dict[str, np.ndarray]
    lengths: dict[str, float]
    #: (dofs, 2) lower and upper bound of each dof, in the bone's own frame; not all bones have limits
    limits: dict[str, np.ndarray]
    #: the limits of revolute and universal joints, and those of ball joints
    ranges: JointRanges
    boxes: EulerBoxes
    #: metres in one unit of the file
    metres: float
    #: true if the angles of the motions are in degrees
    degrees: bool


@checked
@reader_of("an Acclaim skeleton")
def read_asf(path: str | Path) -> Asf:
    """Read an Acclaim skeleton. Lengths are inches divided by the file's `length` unit.

    **Raises:** `InputError` with file and line, if the file is invalid or has unsupported content (bones that
    slide or stretch).
    """
    sections: dict[str, list[tuple[int, str]]] = {}
    current: list[tuple[int, str]] = []
    for number, line in numbered_lines(read_text(path)):
        if line.startswith(":"):
            key, _, value = line[1:].partition(" ")
            current = sections.setdefault(key.lower(), [])
            line = value.strip()
        if line:
            current.append((number, line))
    for key in ("root", "bonedata", "hierarchy"):
        if key not in sections:
            raise InputError(f"{path}: the file has no ':{key}' section; it is incomplete.")
    units = {
        words[0].lower(): (number, words[1])
        for number, line in sections.get("units", [])
        if len(words := line.split()) > 1
    }
    number, length = units.get("length", (0, "1"))
    unit = parse_floats([length], f"{path}:{number}", "the unit of length")[0]
    if not 1e-6 <= unit <= 1e6:
        raise InputError(
            f"{path}:{number}: the unit of length is {unit:g}; expected a number from 1e-06 to 1e+06."
        )
    metres = 0.0254 / unit
    degrees = units.get("angle", (0, "deg"))[1].lower().startswith("deg")
    turn = np.pi / 180 if degrees else 1.0
    root = _fields(sections["root"], path)
    bones = {"root": root, **_bones(sections["bonedata"], path)}
    parents = _hierarchy(sections["hierarchy"], bones, path)

    dofs, frames, lengths, limits = {}, {}, {}, {}
    for name, bone in bones.items():
        dofs[name] = _dofs(name, bone, path)
        angles, order = bone.get("axis", (0, ["0", "0", "0", "XYZ"]))[1][:3], "xyz"
        if name == "root":
            order = "".join(bone.get("axis", (0, ["XYZ"]))[1]).lower()
            angles = bone.get("orientation", (0, ["0", "0", "0"]))[1]
        elif len(bone.get("axis", (0, []))[1]) > 3:
            order = bone["axis"][1][3].lower()
        where = f"{path}:{bone.get('axis', bone['first'])[0]}"
        turned = np.array(parse_floats(angles, where, f"the axis of '{shortened(name)}'")) * turn
        if sorted(order) != ["x", "y", "z"] or len(turned) != 3:
            raise InputError(
                f"{where}: the axis of '{shortened(name)}' is invalid; expected three angles and an order such as XYZ."
            )
        frames[name] = Rotation.from_euler(order, turned).as_matrix()
        if "limits" in bone:
            words = " ".join(bone["limits"][1]).replace("(", " ").replace(")", " ").split()
            pairs = np.array(_bounds(words, f"{path}:{bone['limits'][0]}", name)) * turn
            if len(pairs) != 2 * len(dofs[name]):
                raise InputError(
                    f"{path}:{bone['limits'][0]}: '{shortened(name)}' has {len(dofs[name])} dofs but {len(pairs) / 2:g} limits; expected one for each dof."
                )
            limits[name] = _make_finite(np.sort(pairs.reshape(-1, 2), 1), f"{path}:{bone['limits'][0]}", name)
    order = _root_first(parents)
    position = (
        np.array(_vector(root, "position", "root", path)) * metres if "position" in root else np.zeros(3)
    )
    ends = {"root": position}
    rows = [("root", -1, "free", position)]
    place, inner = {name: joint for joint, name in enumerate(order)}, set(parents.values())
    for name in order[1:]:
        bone, above = bones[name], parents[name]
        direction = np.array(_vector(bone, "direction", name, path))
        size = np.linalg.norm(direction)
        if size < 1e-9:
            raise InputError(
                f"{path}:{bone['direction'][0]}: the direction of '{shortened(name)}' is (0, 0, 0); expected a vector of positive length."
            )
        lengths[name] = _vector(bone, "length", name, path, 1)[0] * metres
        ends[name] = ends[above] + direction / size * lengths[name]
        rotations = len([dof for dof in dofs[name] if dof[0] == "r"])
        rows.append((name, place[above], _KINDS[rotations], ends[above]))
    for name in order[1:]:
        if name not in inner:
            rows.append((name + END_SUFFIX, place[name], "fixed", ends[name]))
    names, above, kinds, centres = zip(*rows, strict=True)
    axes = np.tile(np.eye(3)[:2], (len(rows), 1, 1))
    for joint, name in enumerate(names):
        if kinds[joint] in ("revolute", "universal"):
            # the last dof is outermost, as is a universal joint's first axis
            letters = [dof[1] for dof in reversed(dofs[name])]
            for place, letter in enumerate(letters):
                axes[joint, place] = frames[name][:, "xyz".index(letter)]
    skeleton = make_skeleton(
        names, above, kinds, centres, twist_orientations(np.array(centres), list(above)), axes
    )
    ranges = {
        name: limits[name][::-1].tolist()
        for name, kind in zip(names, kinds, strict=True)
        if kind in ("revolute", "universal") and name in limits
    }
    boxes = {
        name: _box(dofs[name], frames[name], limits[name])
        for name, kind in zip(names, kinds, strict=True)
        if kind == "ball" and name in limits
    }
    return Asf(
        skeleton,
        dofs,
        frames,
        lengths,
        limits,
        make_joint_ranges(skeleton, ranges),
        make_euler_boxes(skeleton, boxes),
        metres,
        degrees,
    )


def _box(dofs: tuple[str, ...], frame: np.ndarray, limits: np.ndarray) -> EulerBox:
    """Build the Euler box of a bone; its first axis is the first dof, as both are applied first."""
    axes = frame[:, ["xyz".index(dof[1]) for dof in dofs]]
    return EulerBox(limits[:, 0], limits[:, 1], axes)


def _fields(lines: list[tuple[int, str]], path) -> dict[str, tuple[int, list[str]]]:
    """Return a bone's keywords with the line and the words of each; limits continue over lines."""
    fields: dict[str, tuple[int, list[str]]] = {"first": (lines[0][0] if lines else 0, [])}
    for number, line in lines:
        words = line.split()
        if line.startswith("(") and "limits" in fields:
            fields["limits"][1].extend(words)
        else:
            fields[words[0].lower()] = (number, words[1:])
    return fields


def _bones(lines: list[tuple[int, str]], path) -> dict[str, dict]:
    bones: dict[str, dict] = {}
    block: list[tuple[int, str]] | None = None
    for number, line in lines:
        if line == "begin":
            block = []
        elif line == "end" and block is not None:
            fields = _fields(block, path)
            if not fields.get("name", (0, []))[1]:
                raise InputError(
                    f"{path}:{number}: the bone that ends on this line has no name; give it a name."
                )
            name = fields["name"][1][0]
            if name in bones or name == "root":
                raise InputError(
                    f"{path}:{fields['name'][0]}: the bone '{shortened(name)}' occurs twice; names must be unique."
                )
            bones[name], block = fields, None
        elif block is None:
            raise InputError(
                f"{path}:{number}: '{shortened(line)}' is outside of 'begin' and 'end'; move it."
            )
        else:
            block.append((number, line))
    if block is not None:
        raise InputError(f"{path}: the last bone has no 'end'; the file is cut short.")
    return bones


def _dofs(name: str, bone: dict, path) -> tuple[str, ...]:
    number, words = bone.get("order" if name == "root" else "dof", (0, []))
    words = tuple(word.lower() for word in words)
    allowed = ("rx", "ry", "rz") + (("tx", "ty", "tz") if name == "root" else ())
    for word in words:
        if word not in allowed or words.count(word) > 1:
            raise InputError(
                f"{path}:{number}: the dof '{shortened(word)}' of '{shortened(name)}' is not supported; expected {', '.join(allowed)}, each at most once."
            )
    return words


def _bounds(words: list[str], where: str, name: str) -> list[float]:
    """Parse limits, with `inf` and `-inf` for none."""
    none = {"inf": math.inf, "+inf": math.inf, "-inf": -math.inf}
    what = f"the limits of '{shortened(name)}'"
    return [
        none[word.lower()] if word.lower() in none else parse_floats([word], where, what)[0] for word in words
    ]


def _make_finite(pairs: Float[np.ndarray, "D 2"], where: str, name: str) -> Float[np.ndarray, "D 2"]:
    """Replace infinite ends of angle ranges, and clip ranges to two turns, more than any joint rotates.

    An open end becomes half a turn, or half a turn from the given end if that is further. Raises `InputError`
    if both ends are the same infinity.
    """
    lower, upper = pairs.T
    if ((lower == np.inf) | (upper == -np.inf)).any():
        raise InputError(
            f"{where}: a limit of '{shortened(name)}' has the same infinity as both bounds; write (-inf inf) for no limit."
        )
    below = np.where(np.isinf(upper), -np.pi, np.minimum(-np.pi, upper - np.pi))
    above = np.where(np.isinf(lower), np.pi, np.maximum(np.pi, lower + np.pi))
    ends = np.stack([np.where(np.isinf(lower), below, lower), np.where(np.isinf(upper), above, upper)], 1)
    return np.clip(ends, -2 * np.pi, 2 * np.pi)


def _vector(bone: dict, key: str, name: str, path, count: int = 3) -> list[float]:
    if key not in bone:
        raise InputError(
            f"{path}:{bone['first'][0]}: '{shortened(name)}' has no {key}; expected {count} numbers."
        )
    number, words = bone[key]
    values = parse_floats(words[:count], f"{path}:{number}", f"the {key} of '{shortened(name)}'")
    if len(values) != count:
        raise InputError(
            f"{path}:{number}: the {key} of '{shortened(name)}' has {len(values)} numbers; expected {count}."
        )
    return values


def _hierarchy(lines: list[tuple[int, str]], bones: dict, path) -> dict[str, str]:
    """Parse the parent of each bone except the root. Raises `InputError`."""
    parents: dict[str, str] = {}
    for number, line in lines:
        words = line.split()
        if words[0] in ("begin", "end"):
            continue
        for name in words:
            if name not in bones:
                raise InputError(
                    f"{path}:{number}: the bone '{shortened(name)}' is not in ':bonedata'; add it."
                )
        for child in words[1:]:
            if child in parents or child == "root":
                raise InputError(
                    f"{path}:{number}: the bone '{shortened(child)}' has two parents; keep one of them."
                )
            parents[child] = words[0]
    for name in bones:
        if name != "root" and name not in parents:
            raise InputError(
                f"{path}:{bones[name]['first'][0]}: the bone '{shortened(name)}' is missing in ':hierarchy'; add it."
            )
    reached = set(_root_first(parents))
    for name in parents:
        if name not in reached:
            raise InputError(
                f"{path}:{bones[name]['first'][0]}: the bone '{shortened(name)}' descends from itself, not from the root; correct its parents."
            )
    return parents


def _root_first(parents: dict[str, str]) -> list[str]:
    """Order all bones below the root depth first, parents before children."""
    below: dict[str, list[str]] = {}
    for child, parent in parents.items():
        below.setdefault(parent, []).append(child)
    order, stack = [], ["root"]
    while stack:
        bone = stack.pop()
        order.append(bone)
        stack += reversed(below.get(bone, []))
    return order
