"""Colours of a mesh's vertices, as PLY, OBJ and GLB files give them."""

from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import UInt8


def read_colours(path: str | Path, count: int) -> UInt8[np.ndarray, "V 4"] | None:
    """Red, green, blue and alpha of the `count` vertices that `read_mesh` found in a file, in its order; None where
    the file gives none, or not one for each of them."""
    import trimesh

    try:
        loaded: Any = trimesh.load(Path(path), process=False, maintain_order=True)
        if isinstance(loaded, trimesh.Scene):
            loaded = loaded.to_geometry() if loaded.geometry else trimesh.Trimesh()
    except Exception:  # `read_mesh` has told what is wrong with the file
        return None
    visual = getattr(loaded, "visual", None)
    if isinstance(loaded, trimesh.PointCloud):
        colours = np.asarray(loaded.colors)
    elif visual is None or getattr(visual, "kind", None) != "vertex":
        return None
    else:
        colours = np.asarray(visual.vertex_colors)
    if colours.shape != (count, 4):
        return None
    return colours.astype(np.uint8)
