"""The warning about contents of a rig's file that the reader of one figure leaves out."""

import warnings
from collections.abc import Iterable, Mapping
from pathlib import Path

#: the types of contents, for both readers
FIGURES = "other figures, which can be read if each is exported separately"
RIGID = "meshes without a skin"
SHAPES = "shape keys of meshes"

#: largest number of listed names for each type
LISTED = 5


def warn_left_out(path: Path, found: Mapping[str, Iterable[str]]) -> None:
    """Warn of contents that are left out, by type and name; silent if there are none."""
    kinds = []
    for kind, names in found.items():
        names = list(dict.fromkeys(names))
        more = f" and {len(names) - LISTED} more" if len(names) > LISTED else ""
        if names:
            kinds.append(f"{kind} ({', '.join(names[:LISTED])}{more})")
    if kinds:
        warnings.warn(f"{path}: not read: {'; '.join(kinds)}.", stacklevel=3)
