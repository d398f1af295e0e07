"""Motions of Acclaim skeletons (`.amc`), read; the transforms are explained in `asf`."""

import itertools
from collections.abc import Sequence
from pathlib import Path

import jax.numpy as jnp
import numpy as np
from scipy.spatial.transform import Rotation

from ...arguments import checked
from ...body.pose import Motion, Pose
from ...errors import InputError
from ..system.reader_errors import reader_of
from ..text import (
    check_frame_rate,
    numbered_lines,
    parse_float_table,
    parse_floats,
    parse_int,
    read_text,
    shortened,
)
from .asf import Asf


@checked
@reader_of("an Acclaim motion")
def read_amc(path: str | Path, asf: Asf, rate: float = 120.0) -> Motion:
    """Read a motion of the skeleton `asf`, as poses of `asf.skeleton`.

    `rate` is in frames per second: the file does not contain it, and the CMU database was recorded at 120.

    **Raises:** `InputError` with file and line, if the file is invalid, cut short, or belongs to another
    skeleton.
    """
    header, rows = [], []
    for number, line in numbered_lines(read_text(path)):
        if line.startswith(":"):
            header.append(line[1:].split()[0].lower() if len(line) > 1 else "")
        else:
            rows.append((number, line))
    if not rows:
        raise InputError(f"{path}: the file has no frames; export it again.")
    counts = {name: len(dofs) for name, dofs in asf.dofs.items() if dofs}
    if not counts:
        raise InputError(
            f"{path}: no bone of the .asf file has degrees of freedom; give the .asf file of this motion."
        )
    values = _parse_table(rows, counts, path)
    if values is None:
        values = _parse_lines(rows, counts, path)
    degrees = "degrees" in header or (asf.degrees and "radians" not in header)
    return _motion(values, asf, np.pi / 180 if degrees else 1.0, rate)


def _parse_table(rows: list[tuple[int, str]], counts: dict[str, int], path) -> dict[str, np.ndarray] | None:
    """Parse a file with one order of bones in all frames to values by bone, `(F, dofs)`.

    None for any other file.
    """
    lines = len(counts) + 1
    first = [line.split() for _, line in rows[:lines]]
    if len(rows) % lines or len(first[0]) != 1:
        return None
    if {words[0]: len(words) - 1 for words in first[1:]} != counts:
        return None
    words = " ".join(line for _, line in rows).split()
    width = sum(len(line) for line in first)
    if len(words) % width or len(words) // width != len(rows) // lines:
        return None
    table = [words[start : start + width] for start in range(0, len(words), width)]
    column, columns = 1, []
    for name, *rest in first[1:]:
        if any(row[column] != name for row in table):
            return None
        columns.append(range(column + 1, column + 1 + len(rest)))
        column += 1 + len(rest)
    numbers = parse_float_table([row[i] for row in table for part in (range(1), *columns) for i in part])
    if numbers is None or not all(row[0].isdecimal() for row in table):
        return None
    numbers = numbers.reshape(len(table), -1)
    _check_order(numbers[:, 0].tolist(), path)
    edges = np.cumsum([1, *map(len, columns)])
    return {name: numbers[:, a:b] for (name, *_), a, b in zip(first[1:], edges, edges[1:], strict=False)}


def _check_order(frames: Sequence[float | int], path: str | Path) -> None:
    """Check that frame numbers increase by one. Raises `InputError`."""
    for before, after in itertools.pairwise(frames):
        if after != before + 1:
            raise InputError(
                f"{path}: frame {after:.0f} follows frame {before:.0f}; expected consecutive numbers."
            )


def _parse_lines(rows: list[tuple[int, str]], counts: dict[str, int], path) -> dict[str, np.ndarray]:
    """Parse a file line by line to values by bone: bones in any order, and every error with its line."""
    frames: list[dict[str, list[float]]] = []
    order: list[int] = []
    where = f"{path}:{rows[0][0]}"

    def complete() -> None:
        missing = [name for name in counts if frames and name not in frames[-1]]
        if missing:
            raise InputError(
                f"{where}: frame {len(frames)} has no line for '{missing[0]}'; the file may be cut short."
            )

    for number, line in rows:
        name, *words = line.split()
        if not words and name.isdecimal():
            complete()
            frames.append({})
            order.append(parse_int(name, f"{path}:{number}", "a frame"))
            where = f"{path}:{number}"
            continue
        where = f"{path}:{number}"
        if not frames:
            raise InputError(
                f"{where}: '{shortened(name)}' comes before the number of the first frame; write the number first."
            )
        if name not in counts:
            raise InputError(
                f"{where}: the bone '{shortened(name)}' has no degrees of freedom in the .asf file; give the .asf file of this motion."
            )
        if name in frames[-1]:
            raise InputError(
                f"{where}: the bone '{name}' occurs twice in frame {len(frames)}; remove one of its lines."
            )
        if len(words) != counts[name]:
            raise InputError(
                f"{where}: the bone '{name}' has {len(words)} numbers; expected {counts[name]}, one for each dof."
            )
        frames[-1][name] = parse_floats(words, where, f"'{name}'")
    complete()
    _check_order(order, path)
    return {name: np.array([frame[name] for frame in frames]) for name in counts}


def _motion(values: dict[str, np.ndarray], asf: Asf, radians_per_unit: float, rate: float) -> Motion:
    skeleton = asf.skeleton
    place = {name: joint for joint, name in enumerate(skeleton.names)}
    frames = len(next(iter(values.values())))
    rotations = np.tile([1.0, 0, 0, 0], (frames, skeleton.num_joints, 1))
    translations = np.zeros((frames, skeleton.num_joints, 3))
    for name, numbers in values.items():
        joint, dofs = place[name], asf.dofs[name]
        turns = [i for i, dof in enumerate(dofs) if dof[0] == "r"]
        if turns:
            order = "".join(dofs[i][1] for i in turns)
            moved = Rotation.from_euler(order, numbers[:, turns] * radians_per_unit)
            frame = Rotation.from_matrix(asf.frames[name])
            rotations[:, joint] = (frame * moved * frame.inv()).as_quat(canonical=True, scalar_first=True)
        for i, dof in enumerate(dofs):
            if dof[0] == "t":
                translations[:, joint, "xyz".index(dof[1])] = numbers[:, i] * asf.metres
    return Motion(
        Pose(jnp.asarray(translations), jnp.asarray(rotations), jnp.ones(frames)),
        check_frame_rate(rate, "the rate"),
    )
