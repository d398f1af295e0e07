"""Wavefront `.obj`: vertices in the order of the file with their colours, and faces.

Other lines are skipped.
"""

from pathlib import Path

import numpy as np
from jaxtyping import Float, Int, UInt8

from ...errors import InputError
from ..system.atomic import write_text
from ..text import numbered_lines, parse_floats, parse_int, read_text


def read_obj(path: Path) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
    """Read `(vertices (V, 3), faces (F, 3), None)` in the file's own unit.

    Normals and texture coordinates are not read: a vertex can have several of them, and splitting it would
    change the order.

    **Raises:** `InputError` with file and line.
    """
    vertices: list[list[float]] = []
    triangles: list[tuple[int, int, int]] = []
    for number, line in numbered_lines(read_text(path).replace("\\\n", " ")):
        words = line.split()
        where = f"{path}:{number}"
        if words[0] == "v":
            if len(words) < 4:
                raise InputError(f"{where}: this vertex has {len(words) - 1} numbers; expected 3.")
            vertices.append(parse_floats(words[1:4], where, "a vertex"))
        elif words[0] == "f":
            corners = [parse_int(word.split("/")[0], where, "a corner") for word in words[1:]]
            corners = [corner + len(vertices) if corner < 0 else corner - 1 for corner in corners]
            if len(corners) < 3 or min(corners) < 0:
                raise InputError(
                    f"{where}: this face has fewer than three corners, or an invalid one; expected vertex numbers from 1 on."
                )
            triangles += [(corners[0], corners[i], corners[i + 1]) for i in range(1, len(corners) - 1)]
    return np.array(vertices).reshape(-1, 3), np.array(triangles, np.int64).reshape(-1, 3), None


def read_obj_colours(path: Path) -> UInt8[np.ndarray, "V 4"] | None:
    """Read the RGBA colours of all vertices, stored as three numbers from 0 to 1 after each position.

    None if a vertex has none. Raises `InputError` with file and line.
    """
    rows = []
    for number, line in numbered_lines(read_text(path).replace("\\\n", " ")):
        words = line.split()
        if words[0] == "v":
            rows.append(parse_floats(words[4:7], f"{path}:{number}", "a colour") if len(words) == 7 else None)
    if not rows or None in rows:
        return None
    colours = np.round(255.0 * np.clip(np.array(rows, float), 0.0, 1.0)).astype(np.uint8)
    return np.concatenate([colours, np.full((len(colours), 1), 255, np.uint8)], 1)


def write_obj(
    path: str | Path,
    vertices: Float[np.ndarray, "V 3"],
    faces: Int[np.ndarray, "F 3"],
    colours: UInt8[np.ndarray, "V _"] | None = None,
) -> None:
    """Write a mesh in its vertex order and unit.

    Red, green and blue of `colours` follow each position, from 0 to 1.

    Most programs read colours in this form.

    **Raises:** `InputError` if the file cannot be written.
    """
    rows = [f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in vertices]
    if colours is not None:
        tints = (f" {r:.4g} {g:.4g} {b:.4g}" for r, g, b in colours[:, :3] / 255.0)
        rows = [row + tint for row, tint in zip(rows, tints, strict=True)]
    rows += [f"f {a} {b} {c}" for a, b, c in faces + 1]
    write_text(path, "\n".join(rows) + "\n")
