"""Morph targets (shape keys) of the meshes in a glTF file."""

from collections.abc import Iterable, Sequence

import numpy as np
from jaxtyping import Float

from ...errors import InputError
from .gltf_file import GltfFile
from .gltf_parts import Part


def find_targets(file: GltfFile, meshes: Iterable[int]) -> dict[str, float]:
    """Find the names of all shape keys of some meshes, with their default weights.

    Names are those of `extras.targetNames`, as Blender and most programs write them, otherwise `target0`, `target1`, ...
    A shape key of several meshes is one, such as that of a face and its teeth.
    """
    found: dict[str, float] = {}
    for mesh in meshes:
        part = file.meshes[mesh]
        names = _names(part)
        weights = part.numbers("weights", len(names))
        for number, name in enumerate(names):
            found.setdefault(name, 0.0 if weights is None else float(weights[number]))
    return found


def read_displacements(
    file: GltfFile, mesh: Part, primitive: Part, names: Sequence[str]
) -> Float[np.ndarray, "V K 3"]:
    """Read the displacements of the vertices of a primitive by the shape keys `names`; zero by those of other meshes.

    **Raises:** `InputError` if a shape key has another number of vertices.
    """
    positions = primitive.part("attributes")
    count = len(file.array(positions.integer("POSITION"), 3, f"{positions.where}.POSITION"))
    file.reserve_memory(3 * count * len(names), "its shape keys")
    found = np.zeros((count, len(names), 3))
    for name, target in zip(_names(mesh), primitive.parts("targets"), strict=False):
        if "POSITION" not in target:
            continue
        moved = file.array(target.integer("POSITION"), 3, f"{target.where}.POSITION")
        if len(moved) != count:
            raise InputError(
                f"{target.where} has {len(moved)} vertices; expected {count}; export the mesh again."
            )
        found[:, names.index(name)] = moved
    return found


def _names(mesh: Part) -> list[str]:
    """Return the names of the shape keys of a mesh, all different."""
    count = max((len(part.values("targets")) for part in mesh.parts("primitives")), default=0)
    stated = mesh.part("extras").content.get("targetNames")
    names = stated if isinstance(stated, list) and len(stated) == count else []
    if not all(isinstance(name, str) and name for name in names) or len(set(names)) < len(names):
        names = []
    return list(names) or [f"target{number}" for number in range(count)]
