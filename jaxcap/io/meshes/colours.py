"""Colours of a mesh's vertices, as PLY, OBJ and GLB files give them."""

from pathlib import Path

import numpy as np
from jaxtyping import UInt8

from .mesh import load_by_trimesh
from .obj import read_obj_colours


def read_colours(path: str | Path, count: int) -> UInt8[np.ndarray, "V 4"] | None:
    """Read the RGBA colours of the `count` vertices of a file, in the order of `read_mesh`.

    None if the file has none, has another number of them, or has another format.
    """
    path, colours = Path(path), None
    if path.suffix.lower() == ".obj":
        colours = read_obj_colours(path)
    elif path.suffix.lower() in (".ply", ".glb", ".gltf"):
        colours = _trimesh_colours(path)
    return colours if colours is not None and colours.shape == (count, 4) else None


def _trimesh_colours(path: Path) -> np.ndarray | None:
    import trimesh

    loaded = load_by_trimesh(path)
    if isinstance(loaded, trimesh.PointCloud):
        return np.asarray(loaded.colors, np.uint8)
    if loaded.visual.kind != "vertex":
        return None
    return np.asarray(loaded.visual.vertex_colors, np.uint8)
