"""Clouds and meshes with normals as binary PLY."""

from pathlib import Path

import numpy as np
from jaxtyping import Float, Int, UInt8

from ..system.atomic import atomic_path


def write_ply(
    path: str | Path,
    points: Float[np.ndarray, "N 3"],
    normals: Float[np.ndarray, "N 3"],
    views: Int[np.ndarray, "N"] | None = None,
    faces: Int[np.ndarray, "F 3"] | None = None,
    colours: UInt8[np.ndarray, "N C"] | None = None,
) -> None:
    """Write points with normals, in metres, as single floats, atomically.

    `views` is written as the integers `view`, `faces` as triangles, and `colours` as red, green, blue and an
    optional alpha.

    **Raises:** `InputError` if the file cannot be written.
    """
    names = ("x", "y", "z", "nx", "ny", "nz")
    fields, head = [(name, "<f4") for name in names], [f"property float {name}" for name in names]
    if views is not None:
        fields, head = [*fields, ("view", "<i4")], [*head, "property int view"]
    colours = np.zeros((len(points), 0), np.uint8) if colours is None else colours
    shown = ("red", "green", "blue", "alpha")[: colours.shape[1]]
    fields = [*fields, *((name, "u1") for name in shown)]
    head = [*head, *(f"property uchar {name}" for name in shown)]
    rows = np.zeros(len(points), fields)
    for name, values in zip(names, np.concatenate([points, normals], 1).T, strict=True):
        rows[name] = values
    if views is not None:
        rows["view"] = views
    for column, name in enumerate(shown):
        rows[name] = colours[:, column]
    lines = ["ply", "format binary_little_endian 1.0", f"element vertex {len(points)}", *head]
    corners = np.zeros(0 if faces is None else len(faces), [("count", "u1"), ("corners", "<i4", 3)])
    if len(corners):
        corners["count"], corners["corners"] = 3, faces
        lines += [f"element face {len(corners)}", "property list uchar int vertex_indices"]
    text = "\n".join([*lines, "end_header"]) + "\n"
    with atomic_path(path) as beside:
        beside.write_bytes(text.encode("ascii") + rows.tobytes() + corners.tobytes())
