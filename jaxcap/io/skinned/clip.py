"""Clips of files with several animations: `character.glb:Walk`."""

import re
from collections.abc import Sequence
from pathlib import Path

from ...errors import InputError

#: formats with several named animations
_CLIP = re.compile(r"(.+?\.(?:glb|gltf)):(.*)", re.IGNORECASE | re.DOTALL)


def split_clip(path: str | Path) -> tuple[Path, str | None]:
    """Split `character.glb:Walk` into the file and the name of its clip, None if no clip is named.

    A path of an existing file is not split.
    """
    match = _CLIP.fullmatch(str(path))
    if match is None or Path(path).exists():
        return Path(path), None
    return Path(match[1]), match[2]


def suffix_of(path: str | Path) -> str:
    """Return the suffix of a file in lower case, without the name of a clip."""
    return split_clip(path)[0].suffix.lower()


def clip_names(animations: Sequence[str | None]) -> tuple[str, ...]:
    """Return a unique name for every animation of a file: its own, or `clip0` and so on."""
    names: dict[str, None] = {}
    # for each name the number of its earlier uses
    times: dict[str, int] = {}
    for number, given in enumerate(animations):
        name = given or f"clip{number}"
        more = times.get(name, 0)
        # underscores up to a hundred uses, then numbers
        while (new := name + ("_" * more if more < 100 else f"_{more}")) in names:
            more += 1
        times[name] = more + 1
        names[new] = None
    return tuple(names)


def clip_number(names: Sequence[str], clip: str | None, path: str | Path) -> int:
    """Find a clip by its name; the first if None.

    **Raises:** `InputError` with the list of names, if there is no such clip.
    """
    if clip is None:
        return 0
    if clip not in names:
        there = f"its clips are {', '.join(names)}" if names else "the file has no clips"
        raise InputError(f"{path}: the file has no clip '{clip}'; {there}.")
    return names.index(clip)
