"""Meshes and point clouds from files: OFF, OBJ and XYZ here, PLY, STL and GLB by trimesh, PCD by pypcd4.

Vertices keep the order of the file, because `.vj` files and ground-truth correspondences depend on it; only
STL, which has no shared vertices, is merged.
"""

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from ...arguments import checked
from ...errors import InputError
from ...geometry.mesh import area_normals
from ...observe.clouds import unit_normals
from ...units import BODY_SIZE, UNIT_NAMES, likely_units, unit_scale
from ..gltf.gltf_scene import check_scene
from ..kinds import wrong_kind_error
from ..system.atomic import atomic_path, write_text
from ..system.confined_paths import InsideResolver
from ..system.reader_errors import reader_of
from ..text import MAX_NUMBER
from .obj import read_obj, write_obj
from .off import read_off
from .ply_check import check_ply
from .point_files import read_pcd, read_xyz

#: suffixes that `read_mesh` supports
SUFFIXES = (".off", ".obj", ".ply", ".stl", ".glb", ".gltf", ".pcd", ".xyz")
#: suffixes that `write_mesh` supports
WRITABLE_SUFFIXES = (".off", ".obj", ".ply", ".stl", ".glb")


class Mesh(NamedTuple):
    """A surface, or a cloud if there are no faces. Metres; indices from 0."""

    vertices: Float[np.ndarray, "V 3"]
    faces: Int[np.ndarray, "F 3"]
    #: unit normals of the file; None if it has none
    normals: Float[np.ndarray, "V 3"] | None = None


@checked
@reader_of("a mesh")
def read_mesh(path: str | Path, unit: str | float = "m") -> Mesh:
    """Read a mesh or a cloud; polygons are split into triangle fans.

    **Arguments:** `unit` of the file's lengths: `m, dm, cm, mm, in, ft` or metres in one.

    **Raises:** `InputError`, with the line in OFF and OBJ, if the file is invalid, has no points, or has
    coordinates that are not finite.
    """
    path = Path(path)
    metres, suffix = unit_scale(unit), path.suffix.lower()
    if suffix not in SUFFIXES:
        raise wrong_kind_error(path, "a mesh or a cloud", SUFFIXES)
    if not path.is_file():
        raise InputError(f"{path}: there is no such file; check the path.")
    reader = {".off": read_off, ".obj": read_obj, ".pcd": read_pcd, ".xyz": read_xyz}.get(
        suffix, _read_trimesh
    )
    vertices, faces, normals = reader(path)
    check_face_indices(faces, len(vertices), path)
    if normals is not None:
        normals = unit_normals(normals)
    vertices = vertices * metres
    check_points(vertices, path)
    return Mesh(vertices, faces.astype(np.int64), normals)


@checked
def write_mesh(path: str | Path, mesh: Mesh, unit: str | float = "m") -> None:
    """Write a mesh, or points without faces, in the format of the path's suffix.

    The order of vertices is kept.

    Normals are kept in `.ply`, and those of a mesh in `.glb`.

    **Raises:** `InputError` if the suffix is unknown, the format cannot hold points, or the file cannot be
    written.
    """
    path = Path(path)
    vertices, faces = np.asarray(mesh.vertices, float) / unit_scale(unit), np.asarray(mesh.faces)
    suffix = path.suffix.lower()
    if suffix == ".off":
        rows = [f"OFF\n{len(vertices)} {len(faces)} 0"]
        rows += [f"{x:.9g} {y:.9g} {z:.9g}" for x, y, z in vertices]
        rows += [f"3 {a} {b} {c}" for a, b, c in faces]
        write_text(path, "\n".join(rows) + "\n")
    elif suffix == ".obj":
        write_obj(path, vertices, faces)
    elif suffix in (".ply", ".stl", ".glb"):
        import trimesh

        if suffix == ".stl" and not len(faces):
            raise InputError(f"{path}: the mesh has no triangles, and .stl cannot contain points; use .ply.")
        # point clouds of trimesh have no normals
        solid = (
            trimesh.Trimesh(vertices, faces, vertex_normals=mesh.normals, process=False)
            if len(faces) or suffix == ".ply"
            else trimesh.PointCloud(vertices)
        )
        data = solid.export(file_type=suffix[1:])
        with atomic_path(path) as beside:
            beside.write_bytes(data if isinstance(data, bytes) else str(data).encode())
    else:
        raise InputError(
            f"{path}: meshes are not written as '{path.suffix}' files; use {', '.join(WRITABLE_SUFFIXES)}."
        )


def check_points(points: np.ndarray, where: str | Path) -> None:
    """Check that there are points, and that none is NaN, infinite or too large. Raises `InputError`."""
    if len(points) == 0:
        raise InputError(f"{where}: it has no points; expected at least one.")
    # half floats cannot hold LARGEST; the comparison with a double converts them
    wrong = ~(np.abs(points) <= np.float64(MAX_NUMBER)).all(1)
    if wrong.any():
        why = "too large" if np.isfinite(points).all() else "NaN or infinite"
        raise InputError(
            f"{where}: {wrong.sum()} of {len(points)} points are {why}, the first is point "
            f"{int(wrong.argmax())}; remove them."
        )


def check_face_indices(faces: np.ndarray, count: int, where: str | Path) -> None:
    """Check that faces refer to `count` vertices only. Raises `InputError`."""
    if faces.size and not (faces.min() >= 0 and faces.max() < count):
        row = int(np.argmax((faces < 0).any(1) | (faces >= count).any(1)))
        raise InputError(
            f"{where}: face {row} refers to vertices {faces[row].tolist()}, but the vertices are 0 to {count - 1}."
        )


def check_mesh(mesh: Mesh, where: str | Path) -> None:
    """Check that a mesh can be a body's surface.

    **Raises:** `InputError` if it has no faces, a face without area, or a vertex that no face uses.
    """
    vertices, faces = np.asarray(mesh.vertices, float), np.asarray(mesh.faces)
    if len(faces) == 0:
        raise InputError(f"{where}: it has no faces; a body needs a surface, not a cloud.")
    flat = flat_faces(vertices, faces)
    if flat.any():
        row = int(flat.argmax())
        raise InputError(
            f"{where}: {flat.sum()} of {len(faces)} faces have no area, the first is face {row} of vertices "
            f"{faces[row].tolist()}; remove them."
        )
    used = np.zeros(len(vertices), bool)
    used[faces] = True
    if not used.all():
        raise InputError(
            f"{where}: {(~used).sum()} of {len(vertices)} vertices are in no face, the first is vertex "
            f"{int(used.argmin())}; remove them."
        )


def flat_faces(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Mark the faces `(F, 3)` that have no area at the precision of the numbers in a file."""
    corners = vertices[faces]
    area = np.linalg.norm(area_normals(corners), axis=1)
    longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(1)
    return area <= 1e-10 * np.maximum(longest, 1e-12) ** 2


def remove_flat_faces(mesh: Mesh) -> Mesh:
    """Remove the faces of a mesh that have no area, and the vertices that no other face uses."""
    faces = np.asarray(mesh.faces)[~flat_faces(np.asarray(mesh.vertices, float), np.asarray(mesh.faces))]
    used, rows = np.unique(faces, return_inverse=True)
    normals = None if mesh.normals is None else np.asarray(mesh.normals)[used]
    return Mesh(np.asarray(mesh.vertices)[used], rows.reshape(faces.shape).astype(faces.dtype), normals)


def check_body_size(extent: float, where: str | Path, unit: str | float = "m") -> None:
    """Check that a body or its cloud, `extent` metres along its longest side, is between 0.3 and 3 m.

    `unit` is the one that the file was read in; the message suggests a likely one.

    **Raises:** `InputError` with the likely unit.
    """
    if BODY_SIZE[0] <= extent <= BODY_SIZE[1]:
        return
    length = float(extent) / unit_scale(unit)
    likely = likely_units(length, *BODY_SIZE)
    hint = (
        f"looks like {UNIT_NAMES[likely[0]]}: pass unit='{likely[0]}' or --unit {likely[0]}"
        if likely
        else "is not a body in any known unit: check the unit"
    )
    raise InputError(
        f"{where}: its longest side is {extent:.4g} m; expected 0.3 to 3 m for a body; this {hint}."
    )


def load_by_trimesh(path: Path) -> Any:
    """Load a mesh or a cloud by trimesh, without textures and materials.

    Files that it names are read from its own folder only.
    """
    import trimesh

    if path.suffix.lower() in (".glb", ".gltf"):
        check_scene(path)
    elif path.suffix.lower() == ".ply":
        check_ply(path)
    more: dict[str, Any] = {"resolver": InsideResolver(path), "skip_materials": True}
    if path.suffix.lower() == ".ply":
        # vertices stay as in the file; trimesh would split them along texture seams
        more["fix_texture"] = False
    # later checks report invalid numbers with their position; NumPy should not warn
    with np.errstate(all="ignore"):
        loaded: Any = trimesh.load(path, process=False, **more)
    if isinstance(loaded, trimesh.Scene):
        loaded = loaded.to_geometry() if loaded.geometry else trimesh.Trimesh()
    return loaded


def _read_trimesh(path: Path):
    try:
        loaded = load_by_trimesh(path)
    except InputError:
        raise
    except Exception as error:  # any error of a reader on a damaged file
        reason = f"{type(error).__name__}: {error}".splitlines()[0][:120].rstrip(". ")
        raise InputError(
            f"{path}: this {path.suffix} file is incomplete or damaged ({reason}); write it again."
        ) from None
    if not hasattr(loaded, "vertices"):
        raise InputError(f"{path}: this file contains no mesh and no points; give a mesh or a cloud.")
    if path.suffix.lower() == ".stl":
        # vertices that are not finite cannot be compared
        check_points(np.asarray(loaded.vertices, float), path)
        loaded.merge_vertices()
    vertices = np.array(loaded.vertices, float).reshape(-1, 3)
    faces = np.array(getattr(loaded, "faces", np.zeros((0, 3))), np.int64).reshape(-1, 3)
    return vertices, faces, _file_normals(loaded)


def _file_normals(loaded) -> np.ndarray | None:
    """Return the normals that are stored in a PLY file, not ones computed from faces."""
    raw = loaded.metadata.get("_ply_raw", {}).get("vertex", {}).get("data")
    names = raw.keys() if isinstance(raw, dict) else getattr(getattr(raw, "dtype", None), "names", None) or ()
    if not {"nx", "ny", "nz"} <= set(names):
        return None
    return np.stack([np.asarray(raw[name], float).reshape(-1) for name in ("nx", "ny", "nz")], 1)
