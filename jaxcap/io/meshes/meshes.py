"""Registered meshes: several meshes with one topology, from many files or one `.npz`."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from ...arguments import checked
from ...errors import InputError
from ...geometry.mesh import count_other_triangles
from ...observe.meshes import MeshSequence
from ...units import unit_scale
from ..archives.archive import array_names, load_arrays
from ..archives.npz import save_arrays
from ..kinds import wrong_arrays_error
from ..system.paths import find_files
from ..system.reader_errors import reader_of
from ..text import check_frame_rate, shortened
from .mesh import check_points, read_mesh

FORMAT = "jaxcap meshes"
_ARRAYS = ("vertices", "faces", "face_counts", "face_indices", "names", "rate")


#: remedy for meshes of several topologies
_REGISTER = "register them by `jaxcap register human SCANS -o registered.npz`"


class NamedMeshes(NamedTuple):
    """A sequence, and the names of its meshes."""

    sequence: MeshSequence
    names: tuple[str, ...]


class _File(NamedTuple):
    names: list[str]
    vertices: Float[np.ndarray, "F V 3"]
    faces: Int[np.ndarray, "T 3"]
    rate: float | None


@checked
def read_meshes(
    paths: str | Path | Sequence[str | Path], unit: str | float = "m", rate: float | None = None
) -> MeshSequence:
    """Read registered meshes: the same vertices in the same order in each.

    **Arguments:** `paths` is one source or a list that is concatenated. A source is a mesh file (`.obj`,
    `.ply`, `.off`, `.glb`; not `.stl`, which has no shared vertices and so no vertex order), a folder of
    them, a quoted glob or a printf pattern, or an `.npz`. The `.npz` has `vertices (F, V, 3)` and `faces (T,
    3)`, or polygons as `face_counts (P,)` and `face_indices (sum,)`, which are split into triangle fans.
    `unit` as in `read_mesh`; `rate` in meshes a second, by default that of the file or 30.

    **Raises:** `InputError` if nothing is found, a file is invalid, or a mesh has other triangles than the
    first.
    """
    return read_named_meshes(paths, unit, rate).sequence


def read_named_meshes(
    paths: str | Path | Sequence[str | Path], unit: str | float = "m", rate: float | None = None
) -> NamedMeshes:
    """Read registered meshes as `read_meshes` does, with their names for messages."""
    return _read_groups(paths, [[paths] if isinstance(paths, str | Path) else list(paths)], unit, rate)[0]


def read_mesh_groups(
    groups: Sequence[Sequence[str | Path]], unit: str | float = "m", rate: float | None = None
) -> list[NamedMeshes]:
    """Read groups of registered meshes in one topology, such as those of several people; each has the rate of its own files.

    **Arguments:** `groups`, the sources of each, as `paths` of `read_meshes`.

    **Raises:** `InputError` as `read_meshes` does, and if the topology of a file is not that of the first file of all.
    """
    return _read_groups("the meshes", groups, unit, rate)


@reader_of("registered meshes")
def _read_groups(
    _where: str | Path | Sequence[str | Path],
    groups: Sequence[Sequence[str | Path]],
    unit: str | float,
    rate: float | None,
) -> list[NamedMeshes]:
    metres = unit_scale(unit)
    if not all(groups):
        raise InputError("No meshes were given; give files, a folder or an .npz.")
    found = [
        [path for source in group for path in find_files(source, check_gaps=False, extra_suffixes=(".npz",))]
        for group in groups
    ]
    read = [[_read(path) for path in paths] for paths in found]
    for paths, files in zip(found, read, strict=True):
        for path, file in zip(paths, files, strict=True):
            _check_same_topology(path, file, found[0][0], read[0][0])
    return [_concatenate(files, metres, read[0][0].faces, rate) for files in read]


def _concatenate(
    files: Sequence[_File], metres: float, faces: Int[np.ndarray, "T 3"], rate: float | None
) -> NamedMeshes:
    rates = [file.rate for file in files if file.rate is not None]
    names = tuple(name for file in files for name in file.names)
    vertices = metres * np.concatenate([file.vertices for file in files])
    return NamedMeshes(MeshSequence(vertices, faces, rate or (rates[0] if rates else 30.0)), names)


@checked
def save_meshes(
    path: str | Path,
    sequence: MeshSequence,
    names: Sequence[str] = (),
    extra_arrays: Mapping[str, np.ndarray] | None = None,
) -> None:
    """Write a sequence as an `.npz` for `read_meshes`.

    **Arguments:** `names` of the meshes, for messages; `extra_arrays` by name, which `read_meshes` ignores, such as
    `seen (F, V)` and `distances (F, V)` of registered scans.

    **Raises:** `InputError` if there is not one name for each mesh, an extra array has the name of one of the format,
    or the file cannot be written.
    """
    extra = dict(extra_arrays or {})
    taken = sorted(set(extra) & set(_ARRAYS))
    if taken:
        raise InputError(
            f"save_meshes: `extra_arrays` has '{taken[0]}', an array of the format; give it another name."
        )
    if names and len(names) != len(sequence):
        raise InputError(
            f"save_meshes: there are {len(names)} `names` for {len(sequence)} meshes; give one for each mesh."
        )
    arrays = {"vertices": sequence.vertices, "faces": sequence.faces, "rate": np.array(sequence.rate, float)}
    named = {"names": np.array(names, dtype=str)} if names else {}
    save_arrays(path, FORMAT, {**arrays, **named, **extra})


def triangulate(
    counts: Int[np.ndarray, "P"], indices: Int[np.ndarray, "N"], where: str | Path = "The mesh"
) -> Int[np.ndarray, "T 3"]:
    """Split polygons, with `counts` corners each, concatenated in `indices`, into triangle fans.

    **Raises:** `InputError` if the two are inconsistent, or a polygon has fewer than three corners.
    """
    counts, indices = np.asarray(counts), np.asarray(indices)
    # each count is checked, as large counts could overflow to the right sum
    if (counts < 3).any() or (counts > len(indices)).any() or counts.sum() != len(indices):
        raise InputError(
            f"{where}: the counts of the faces sum to {counts.sum()} corners, and there are {len(indices)} indices; the "
            f"smallest count is {counts.min(initial=3)}; expected equal sums, and at least 3 corners for each face."
        )
    starts = np.cumsum(counts) - counts
    polygon = np.repeat(np.arange(len(counts)), counts - 2)
    fan = np.arange(len(polygon)) - np.repeat(np.cumsum(counts - 2) - (counts - 2), counts - 2)
    first = starts[polygon]
    return indices[np.stack([first, first + fan + 1, first + fan + 2], 1)]


def _read(path: Path) -> _File:
    if path.suffix.lower() == ".npz":
        return _arrays(path)
    if path.suffix.lower() == ".stl":
        raise InputError(
            f"{path}: an .stl file has no shared vertices, so meshes do not have one vertex order; use .ply or .obj."
        )
    mesh = read_mesh(path)
    if len(mesh.faces) == 0:
        raise InputError(f"{path}: it has no faces; a registered mesh is a surface, not a cloud.")
    return _File([str(path)], mesh.vertices[None], mesh.faces, None)


def _arrays(path: Path) -> _File:
    arrays, stored = load_arrays(path, lambda name: name in _ARRAYS), array_names(path)
    vertices = arrays.get("vertices")
    if vertices is None or "skin" in stored:
        raise wrong_arrays_error(path, "registered meshes, an array 'vertices' (F, V, 3)")
    if vertices.dtype.kind not in "fiu":
        raise InputError(f"{path}: 'vertices' has the type {vertices.dtype}; expected numbers, (F, V, 3).")
    if vertices.ndim == 2:
        vertices = vertices[None]
    if vertices.ndim != 3 or vertices.shape[-1] != 3 or not vertices.size:
        raise InputError(f"{path}: the vertices have the shape {vertices.shape}; expected (F, V, 3).")
    faces = arrays.get("faces")
    if faces is None and {"face_counts", "face_indices"} <= set(arrays):
        faces = triangulate(
            _check_integers(arrays["face_counts"], "face_counts", path),
            _check_integers(arrays["face_indices"], "face_indices", path),
            path,
        )
    if faces is None or faces.dtype.kind not in "iu":
        held_as = "is missing" if faces is None else f"has the type {faces.dtype}"
        raise InputError(
            f"{path}: the array 'faces' {held_as}; write triangles as whole numbers, 'faces' (T, 3), or polygons as "
            "'face_counts' and 'face_indices'."
        )
    if faces.ndim == 2 and faces.shape[1] > 3:
        faces = triangulate(np.full(len(faces), faces.shape[1]), faces.reshape(-1), path)
    if faces.ndim != 2 or faces.shape[1] != 3 or not len(faces):
        raise InputError(f"{path}: the faces have the shape {faces.shape}; expected (T, 3).")
    if not (faces.min() >= 0 and faces.max() < vertices.shape[1]):
        raise InputError(
            f"{path}: a face refers to vertex {faces.min() if faces.min() < 0 else faces.max()}, but the vertices are "
            f"0 to {vertices.shape[1] - 1}."
        )
    given = arrays.get("names", np.zeros(0))
    named = given.shape == (len(vertices),) and given.dtype.kind == "U"
    names = [
        f"{path}[{shortened(str(name))}]" for name in (given.tolist() if named else range(len(vertices)))
    ]
    for name, mesh in zip(names, vertices, strict=True):
        check_points(mesh, name)
    rate = arrays.get("rate")
    if rate is not None and not (rate.shape == () and rate.dtype.kind in "fiu"):
        raise InputError(
            f"{path}: the rate has the shape {rate.shape} and the type {rate.dtype}; expected one number above 0."
        )
    rate = None if rate is None else check_frame_rate(rate.item(), str(path))
    return _File(names, vertices.astype(float), faces.astype(np.int64), rate)


def _check_integers(values: np.ndarray, name: str, path: Path) -> np.ndarray:
    """Return a list of integers after a check. Raises `InputError`."""
    if values.ndim != 1 or values.dtype.kind not in "iu":
        raise InputError(
            f"{path}: the array '{name}' has the shape {values.shape} and the type {values.dtype}; expected a list of "
            "whole numbers."
        )
    return values.astype(np.int64)


def _check_same_topology(path: Path, file: _File, first: Path, reference: _File) -> None:
    counts = [(f.vertices.shape[1], len(f.faces)) for f in (file, reference)]
    if counts[0] != counts[1]:
        raise InputError(
            f"{path}: this mesh has {counts[0][0]} vertices and {counts[0][1]} triangles, and {first} has "
            f"{counts[1][0]} and {counts[1][1]}; registered meshes have one topology; {_REGISTER}."
        )
    # a file may list the same triangles in another order, or start each at another corner
    other = count_other_triangles(file.faces, reference.faces)
    if other:
        raise InputError(
            f"{path}: {other} of its {counts[0][1]} triangles connect other vertices than in {first}; "
            f"registered meshes have one topology and one vertex order; {_REGISTER}."
        )
