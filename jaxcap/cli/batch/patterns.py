"""Patterns with named parts, such as `takes/{subject}/{take}.c3d`, and the files that match them."""

import glob
import os
import re
from collections.abc import Iterator, Mapping
from pathlib import Path, PurePosixPath

from ...errors import InputError
from ...io.system.paths import natural_sort_key
from .urls import glob_urls, is_url

#: a named part, of a pattern or of a command
NAMED = re.compile(r"\{([A-Za-z_]\w*)\}")
#: the file, its name without suffix, and its folder: names that every pattern gives
INPUT, STEM, FOLDER = "input", "stem", "folder"
_WILDCARDS = re.compile(r"\{[A-Za-z_]\w*\}|\*\*/|\*\*|\*|\?|\[[^\]/]+\]")


def match_pattern(pattern: str) -> list[dict[str, str]]:
    """Find the files and folders that match a pattern, in natural order, each as the values of its names.

    A named part matches within one folder or file name, and the same name everywhere the same text; `*`, `?`, `[...]` and `**` are
    those of a shell. The name `input` is the path, `stem` its last part without suffix, and `folder` its folder.

    **Raises:** `InputError` if nothing matches, or a part is named like one of these.
    """
    for name in NAMED.findall(pattern):
        if name in (INPUT, STEM, FOLDER):
            raise InputError(
                f"{pattern}: the name '{name}' is that of the file itself; give this part another name."
            )
    found = [values for path in _candidates(pattern) if (values := _values(pattern, path)) is not None]
    if not found and not is_pattern(pattern):
        raise InputError(f"{pattern}: there is no such file or folder; check the path.")
    if not found:
        raise InputError(f"{pattern}: no file or folder matches this pattern; check the path and the names.")
    return found


def matches_pattern(pattern: str, output: str) -> bool:
    """Test if the path or URL of an output matches a pattern of inputs."""
    if not is_url(output):
        output = os.path.abspath(output) if os.path.isabs(pattern) else os.path.relpath(output)
    return _values(pattern, output) is not None


def is_pattern(text: str) -> bool:
    """Test if a text has named parts or wildcards, or is a URL; otherwise it names one file or folder."""
    return is_url(text) or NAMED.search(text) is not None or glob.has_magic(text)


def fill(template: str, values: Mapping[str, str]) -> str:
    """Replace the named parts of a text by their values. Raises `InputError` if a name has no value, or an empty one."""

    def value_of(match: re.Match) -> str:
        if match[1] not in values:
            raise InputError(f"'{match[0]}' has no value; the names are {', '.join(values) or 'none'}.")
        if not values[match[1]]:
            raise InputError(f"the value of '{match[0]}' is empty; write one.")
        return values[match[1]]

    return NAMED.sub(value_of, template)


def _candidates(pattern: str) -> Iterator[str]:
    plain = NAMED.sub("*", pattern)
    if is_url(plain):
        yield from sorted(glob_urls(plain))
    elif glob.has_magic(plain):
        found = {Path(path) for path in glob.glob(plain, recursive=True)}
        yield from (path.as_posix() for path in sorted(found, key=natural_sort_key))
    else:
        yield from glob.glob(plain)


def _values(pattern: str, path: str) -> dict[str, str] | None:
    match = _regular_expression(pattern).fullmatch(path)
    if match is None:
        return None
    there = PurePosixPath(path)
    folder = path.rpartition("/")[0] or "."
    return {**match.groupdict(), INPUT: path, STEM: there.stem, FOLDER: folder}


def _regular_expression(pattern: str) -> re.Pattern:
    # as paths are normalised by `PurePosixPath`
    pattern = pattern if is_url(pattern) else str(PurePosixPath(pattern))
    named: set[str] = set()
    parts, end = [], 0
    for match in _WILDCARDS.finditer(pattern):
        parts.append(re.escape(pattern[end : match.start()]))
        parts.append(_part(match[0], named))
        end = match.end()
    return re.compile("".join([*parts, re.escape(pattern[end:])]), re.DOTALL)


def _part(wildcard: str, named: set[str]) -> str:
    """Translate a wildcard to a regular expression; `named` are the names so far."""
    plain = {"**/": "(?:.*/)?", "**": ".*", "*": "[^/]*", "?": "[^/]"}
    if wildcard in plain:
        return plain[wildcard]
    if wildcard[0] == "[":
        return wildcard.replace("[!", "[^", 1)
    name = wildcard[1:-1]
    if name in named:
        return f"(?P={name})"
    named.add(name)
    return f"(?P<{name}>[^/]+?)"
