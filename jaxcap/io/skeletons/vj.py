"""The joint of each vertex (`.vj`), read and written (Kineben, section 4.2).

Each line is a joint name; the line number is the vertex.
"""

from pathlib import Path

import numpy as np
from jaxtyping import Int

from ...arguments import checked
from ...body.skeleton import Skeleton
from ...errors import InputError
from ..kinds import check_kind
from ..system.atomic import write_text
from ..system.reader_errors import reader_of
from ..text import read_text, shortened


@checked
@reader_of("the parts of a mesh")
def read_vj(path: str | Path, skeleton: Skeleton, num_vertices: int) -> Int[np.ndarray, "V"]:
    """Read the bone of each of a mesh's `num_vertices` vertices.

    **Raises:** `InputError` with file and line, for an unknown joint, an empty line, or a number of lines
    other than that of vertices.
    """
    check_kind(path, "vj", (".vj",))
    lines = [line.strip() for line in read_text(path).splitlines()]
    while lines and not lines[-1]:
        lines.pop()
    indices = {name: joint for joint, name in enumerate(skeleton.names)}
    for number, name in enumerate(lines, 1):
        if name not in indices:
            what = f"'{shortened(name)}' is not a joint of the skeleton" if name else "this line is empty"
            raise InputError(
                f"{path}:{number}: {what}; expected one of {', '.join(skeleton.names)} for vertex {number - 1}."
            )
    if len(lines) != num_vertices:
        than = "more than" if len(lines) > num_vertices else "fewer than"
        raise InputError(
            f"{path}:{len(lines)}: there are {len(lines)} lines, {than} the mesh's {num_vertices} vertices; "
            "give the .vj file of this mesh."
        )
    return np.array([indices[name] for name in lines], np.int64)


@checked
def write_vj(path: str | Path, skeleton: Skeleton, bones: Int[np.ndarray, "V"]) -> None:
    """Write the bone of each vertex. Raises `InputError` if the file cannot be written."""
    write_text(path, "".join(f"{skeleton.names[int(bone)]}\n" for bone in bones))
