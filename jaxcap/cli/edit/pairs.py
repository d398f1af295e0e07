"""Text files of matched pairs of source and target, one per line."""

from pathlib import Path

from ...edit.retargeting.point_pairs import PointPair
from ...errors import InputError
from ...io.skeletons.joint_names import read_joint_names
from ...io.text import parse_floats, parse_int, read_text


def read_pair_table(path: Path) -> list[list[str]]:
    """Split every non-empty line of a text file into words; `#` begins a comment.

    **Raises:** `InputError` if the file cannot be read or a line has other than two or three words.
    """
    rows = []
    for number, line in enumerate(read_text(path).splitlines(), 1):
        words = line.split("#")[0].split()
        if not words:
            continue
        if len(words) not in (2, 3):
            raise InputError(
                f"{path}:{number}: this line has {len(words)} words; expected a source, a target, and optionally a "
                "weight."
            )
        rows.append([str(number), *words])
    if not rows:
        raise InputError(f"{path}: this file has no pairs; write one per line.")
    return rows


def read_name_pairs(path: Path) -> dict[str, str | None]:
    """Read the table of joints in a `.json` file, or in a text file with two names per line. Raises
    `InputError`."""
    if path.suffix.lower() == ".json":
        return read_joint_names(path)
    names: dict[str, str | None] = {}
    for number, here, *there in read_pair_table(path):
        if here in names:
            raise InputError(
                f"{path}:{number}: the joint '{here}' occurs in two lines; give each joint of the source once."
            )
        names[here] = there[0]
    return names


def parse_point_pair(path: Path, row: list[str]) -> PointPair:
    """Parse a row of `read_pair_table`, which begins with its line number. Raises `InputError`."""
    number, here, there, *weight = row
    where = f"{path}:{number}"
    heavy = parse_floats(weight, where, "the weight")[0] if weight else 1.0
    ends = (parse_int(word, where, "a vertex") if word.isdecimal() else word for word in (here, there))
    return PointPair(*ends, weight=heavy)
