"""Lists of what a file holds, of as many lines as anyone reads."""

import itertools
from collections.abc import Iterable

from ..console.console import say

#: lines of a list, and steps of an indentation
MOST, DEEPEST = 200, 20


def say_list(lines: Iterable[str], count: int, what: str) -> None:
    """Say the first of `count` lines, and how many more of `what` there are."""
    for line in itertools.islice(lines, MOST):
        say(line)
    if count > MOST:
        say(f"  ... and {count - MOST} more {what}")


def indented(text: str, depth: int) -> str:
    """Write a line of a tree below its parent; what is very deep is no further to the right."""
    return "  " * (min(depth, DEEPEST) + 1) + text
