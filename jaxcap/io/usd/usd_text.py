"""Error messages for USD layers that OpenUSD cannot parse."""

import re
from pathlib import Path

from ...errors import InputError
from ..text import shortened

#: the start of a message of the text parser: file, line, column
_MESSAGE_LOCATION = re.compile(r"'?(?P<file>[^\n']*?):(?P<line>\d+):\d+: ")


def check_text(path: Path) -> None:
    """Check that a text layer is UTF-8. Raises `InputError` with the line."""
    data = path.read_bytes()
    try:
        if data.startswith(b"#usda"):
            data.decode()
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        raise InputError(f"{path}:{line}: this line is not UTF-8; export the file again.") from None


def parse_error(path: Path, error: Exception) -> InputError:
    """Return the error for a file that OpenUSD rejects, with the line in the file or in one of its layers."""
    # the text after the position in OpenUSD's own source
    lines = [line.partition(" in file ")[2].partition(" : ")[2] or line for line in str(error).splitlines()]
    reason = next((line.strip(" \t'.") for line in reversed(lines) if line.strip(" \t'.")), "")
    place = _MESSAGE_LOCATION.match(reason)
    if place is None:
        why = f" ({shortened(reason)})" if reason else ", and OpenUSD gives no reason"
        return InputError(f"{path}: this USD file is incomplete or damaged{why}; export it again.")
    # the parser reports its grammar rules if it has no message
    words = reason[place.end() :].removesuffix("'").strip()
    near = re.search(r" at '(.*?)'(?: in <(.*?)>)?$", words)
    inside = f", in {shortened(near[2])}" if near and near[2] else ""
    if near and not near[1]:
        found = f"the text ends{inside} before it is complete"
    elif near:
        found = f"'{shortened(near[1])}' is unexpected{inside}"
    else:
        found = f"the syntax is invalid ({shortened(words)})"
    layer = "" if Path(place["file"]).name == path.name else f"{Path(place['file']).name}:"
    where = f"{path}: {layer}{place['line']}" if layer else f"{path}:{place['line']}"
    return InputError(f"{where}: {found}; this USD file is incomplete or damaged, so export it again.")
