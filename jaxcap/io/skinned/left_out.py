"""The warning about contents of a rig's file that the reader of one figure leaves out."""

import warnings
from collections.abc import Iterable, Mapping
from pathlib import Path

#: the types of contents, for both readers
OTHER_FIGURES = "other figures, which can be read if each is exported separately"
UNSKINNED_MESHES = "meshes without a skin"
SHAPE_KEYS = "shape keys of meshes"

#: largest number of listed names for each type
MAX_LISTED_NAMES = 5


def warn_of_unread_content(path: Path, found: Mapping[str, Iterable[str]]) -> None:
    """Warn of contents that are left out, by type and name; silent if there are none."""
    kinds = []
    for kind, names in found.items():
        names = list(dict.fromkeys(names))
        more = f" and {len(names) - MAX_LISTED_NAMES} more" if len(names) > MAX_LISTED_NAMES else ""
        if names:
            kinds.append(f"{kind} ({', '.join(names[:MAX_LISTED_NAMES])}{more})")
    if kinds:
        warnings.warn(f"{path}: not read: {'; '.join(kinds)}.", stacklevel=3)
