"""Named vertices of a body, read from text.

# marker  vertex
LFHD      1023
RFHD      88
"""

from pathlib import Path

from ...errors import InputError
from ..system.reader_errors import reader_of
from ..text import numbered_lines, parse_int, read_text, shortened


@reader_of("a vertex list")
def read_vertex_list(path: str | Path) -> dict[str, int]:
    """Read names with the vertex of each; a line with only a number gets the name `v` and the number.

    **Raises:** `InputError` with file and line, for a line of more than two words, a vertex that is no number
    from 0, or a duplicate name; also if the list is empty.
    """
    found: dict[str, int] = {}
    for number, line in numbered_lines(read_text(path)):
        words, where = line.split(), f"{path}:{number}"
        if len(words) > 2:
            raise InputError(
                f"{where}: '{shortened(line)}' has {len(words)} words; expected a name and a vertex."
            )
        vertex = parse_int(words[-1], where, "the vertex")
        if vertex < 0:
            raise InputError(f"{where}: the vertex is {vertex}; expected an index of at least 0.")
        name = words[0] if len(words) == 2 else f"v{vertex}"
        if name in found:
            raise InputError(
                f"{where}: the name '{shortened(name)}' occurs twice; give each marker a unique name."
            )
        found[name] = vertex
    if not found:
        raise InputError(f"{path}: the file lists no vertices; write a name and a vertex on each line.")
    return found
