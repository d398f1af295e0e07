"""Object File Format (`.off`): text, with optional normals, colours and texture coordinates."""

import re
from pathlib import Path

import numpy as np

from ...errors import InputError
from ..text import numbered_lines, parse_float_table, parse_floats, parse_int, read_text


def read_off(path: Path) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
    """Read `(vertices (V, 3), faces (F, 3), normals (V, 3) or None)` in the file's own unit.

    Supports `OFF`, `COFF`, `NOFF`, `STOFF` and their combinations, with the counts on the first line or the
    next, comments, and polygons.

    **Raises:** `InputError` with file and line.
    """
    lines = list(numbered_lines(read_text(path)))
    if not lines:
        raise InputError(f"{path}: this file is empty; write it again.")
    number, first = lines.pop(0)
    keyword, *counts = first.split()
    header = re.fullmatch(r"(ST)?(C)?(N)?OFF", keyword, re.IGNORECASE)
    if not header or (counts and counts[0].upper() == "BINARY"):
        raise InputError(
            f"{path}:{number}: the file begins with '{first[:40]}'; expected OFF, COFF, NOFF or STOFF in a text file."
        )
    if not counts:
        if not lines:
            raise InputError(f"{path}:{number}: the numbers of vertices and faces are missing; write both.")
        number, line = lines.pop(0)
        counts = line.split()
    if len(counts) < 2:
        raise InputError(f"{path}:{number}: the numbers of vertices and faces are missing; write both.")
    num_vertices = parse_int(counts[0], f"{path}:{number}", "the number of vertices")
    num_faces = parse_int(counts[1], f"{path}:{number}", "the number of faces")
    if min(num_vertices, num_faces) < 0:
        raise InputError(
            f"{path}:{number}: the header declares {num_vertices} vertices and {num_faces} faces; expected numbers of at least 0."
        )
    if len(lines) < num_vertices + num_faces:
        raise InputError(
            f"{path}:{lines[-1][0] if lines else number}: the header declares {num_vertices} vertices and {num_faces} "
            f"faces, but {len(lines)} lines follow; the file is cut short."
        )
    width = 6 if header[3] else 3
    numbers = _rows(lines[:num_vertices], width, path)
    faces = _faces(lines[num_vertices : num_vertices + num_faces], num_vertices, path)
    return numbers[:, :3], faces, numbers[:, 3:] if header[3] else None


def _rows(lines: list[tuple[int, str]], width: int, path: Path) -> np.ndarray:
    """Parse the first `width` numbers of each line; colours may follow. The caller checks for NaN."""
    words = [line.split()[:width] for _, line in lines]
    for (number, _), row in zip(lines, words, strict=True):
        if len(row) != width:
            raise InputError(f"{path}:{number}: this vertex has {len(row)} numbers; expected {width}.")
    numbers = parse_float_table([word for row in words for word in row])
    if numbers is not None:
        return numbers.reshape(-1, width)
    rows = [
        [_number(word, f"{path}:{number}") for word in row]
        for (number, _), row in zip(lines, words, strict=True)
    ]
    return np.array(rows, float).reshape(-1, width)


def _number(word: str, where: str) -> float:
    """Parse a number, NaN or infinity; the caller reports those that are not finite."""
    plain = word.lower().strip("+-")
    return float(plain) if plain in ("nan", "inf") else parse_floats([word], where, "a vertex")[0]


def _faces(lines: list[tuple[int, str]], num_vertices: int, path: Path) -> np.ndarray:
    triangles = []
    for number, line in lines:
        words = line.split()
        where = f"{path}:{number}"
        count = parse_int(words[0], where, "the number of corners")
        if not 0 <= count < len(words):
            raise InputError(
                f"{where}: this face declares {count} corners and has {len(words) - 1}; correct the number."
            )
        corners = [parse_int(word, where, "a corner") for word in words[1 : count + 1]]
        for corner in corners:
            if not 0 <= corner < num_vertices:
                raise InputError(
                    f"{where}: this face refers to vertex {corner}, but the vertices are 0 to {num_vertices - 1}."
                )
        triangles += [(corners[0], corners[i], corners[i + 1]) for i in range(1, count - 1)]
    return np.array(triangles, np.int64).reshape(-1, 3)
