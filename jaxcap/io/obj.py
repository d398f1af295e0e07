"""Wavefront `.obj`: vertices in the order of the file, and faces; all else is passed over."""

from pathlib import Path

import numpy as np

from ..errors import InputError
from .text import numbered_lines, parse_floats, parse_int, read_text


def read_obj(path: Path) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
    """`(vertices (V, 3), faces (F, 3), None)` in the file's own unit.

    Normals and texture coordinates are not read: a vertex has many of them there, and to
    split it would change the order.

    **Raises:** `InputError` with file and line.
    """
    vertices: list[list[float]] = []
    triangles: list[tuple[int, int, int]] = []
    for number, line in numbered_lines(read_text(path).replace("\\\n", " ")):
        words = line.split()
        where = f"{path}:{number}"
        if words[0] == "v":
            if len(words) < 4:
                raise InputError(f"{where}: this vertex has {len(words) - 1} numbers; give 3.")
            vertices.append(parse_floats(words[1:4], where, "a vertex"))
        elif words[0] == "f":
            corners = [parse_int(word.split("/")[0], where, "a corner") for word in words[1:]]
            corners = [corner + len(vertices) if corner < 0 else corner - 1 for corner in corners]
            if len(corners) < 3 or min(corners) < 0:
                raise InputError(f"{where}: this face needs three corners, counted from 1.")
            triangles += [(corners[0], corners[i], corners[i + 1]) for i in range(1, len(corners) - 1)]
    return np.array(vertices).reshape(-1, 3), np.array(triangles, np.int64).reshape(-1, 3), None
