"""The result of a description, and lists of a file's contents, of limited length."""

import itertools
from collections.abc import Iterable
from typing import NamedTuple

from ..console.console import say

#: maximum number of lines of a list, and maximum depth of an indentation
MAX_LINES, DEEPEST = 200, 20


class Contents(NamedTuple):
    """The kind of a file's contents, and what its next command needs, if anything."""

    kind: str
    #: unit of lengths
    unit: str | None = None
    #: units in a metre of depth images, if the given number is wrong
    depth_scale: float | None = None


def print_list(lines: Iterable[str], count: int, what: str) -> None:
    """Print the first of `count` lines, and the number of further `what`."""
    for line in itertools.islice(lines, MAX_LINES):
        say(line)
    if count > MAX_LINES:
        say(f"  ... and {count - MAX_LINES} more {what}")


def indented(text: str, depth: int) -> str:
    """Indent a line of a tree by its depth, up to a maximum."""
    return "  " * (min(depth, DEEPEST) + 1) + text
