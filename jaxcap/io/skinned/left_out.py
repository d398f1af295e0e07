"""The warning of what a file of a rig has and a reader of one figure leaves out."""

import warnings
from collections.abc import Iterable, Mapping
from pathlib import Path

#: the kinds, as both readers call them
FIGURES = "other figures, which can be read when each is exported by itself"
RIGID = "meshes that follow no joint"
SHAPES = "shape keys of meshes"

#: names that are listed of each kind
LISTED = 5


def warn_left_out(path: Path, found: Mapping[str, Iterable[str]]) -> None:
    """Warn of what is left out, by kind and name; silent where there is nothing."""
    kinds = []
    for kind, names in found.items():
        names = list(dict.fromkeys(names))
        more = f" and {len(names) - LISTED} more" if len(names) > LISTED else ""
        if names:
            kinds.append(f"{kind} ({', '.join(names[:LISTED])}{more})")
    if kinds:
        warnings.warn(f"{path}: left out: {'; '.join(kinds)}.", stacklevel=3)
