"""Sequences of clouds: numbered files, folders, globs, or one `.npz`; loaded on demand."""

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float

from ...arguments import checked
from ...errors import InputError
from ...geometry.mesh import vertex_normals
from ...observe import Scan as Scan
from ...observe.clouds import Cloud
from ...units import unit_scale
from ..archives.archive import array_names, load_arrays
from ..kinds import wrong_arrays_error
from ..lazy_frames import LazyFrames
from ..system.atomic import atomic_path
from ..system.paths import find_files, order_files, select_range
from ..system.reader_errors import reader_of
from ..text import MAX_NUMBER
from .mesh import check_face_indices, check_points, read_mesh

_ARRAYS = ("points", "vertices", "normals", "offsets", "faces")
#: the faces of a cloud
NO_FACES = np.zeros((0, 3), int)
#: points, normals and triangles of a frame
FrameLoader = Callable[[int], tuple[np.ndarray, np.ndarray | None, np.ndarray]]


class Scans(LazyFrames[Scan]):
    """A sequence of clouds that are loaded on demand.

    An element has points, normals or None, and triangles (`NO_FACES` for a cloud).
    """

    def __init__(self, names: Sequence[str], load: FrameLoader):
        def load_checked(frame: int) -> Scan:
            points, normals, faces = load(frame)
            check_points(points, names[frame])
            return Scan(names[frame], points, normals, faces)

        super().__init__(names, load_checked)


@checked
@reader_of("clouds")
def read_clouds(
    source: str | Path | Sequence[str | Path],
    first: int | None = None,
    last: int | None = None,
    unit: str | float = "m",
) -> Scans:
    """Open a sequence of clouds.

    **Arguments:** `source` is a printf pattern (`cloud_%03d.off`), a glob, a folder, one mesh file, or an
    `.npz`. The `.npz` has `points (F, N, 3)`, or `points (T, 3)` and `offsets (F + 1,)` for clouds of
    different sizes (`normals` of the same shape), or `vertices (F, V, 3)` and `faces (T, 3)`. `source` may
    also be several mesh files, each one frame, which are sorted by the numbers in their names, as by a glob.
    `first` and `last`, both included, are the numbers in a pattern, and otherwise frames counted from 0.
    `unit` as in `read_mesh`.

    **Raises:** `InputError` if nothing is found, a number is missing in a numbered sequence, or several
    sources are not all mesh files; also, when it is loaded, if a cloud is invalid.
    """
    metres = unit_scale(unit)
    sources = [source] if isinstance(source, str | Path) else list(source)
    if not sources:
        raise InputError("No clouds were given; give files, a folder, a pattern or an .npz.")
    path = Path(sources[0])
    if len(sources) > 1:
        paths = order_files(sources, first, last)
    elif path.suffix.lower() == ".npz" and not path.is_dir():
        return _arrays(path, first, last, metres)
    else:
        paths = find_files(sources[0], first, last)

    def load(frame: int):
        mesh = read_mesh(paths[frame], unit)
        if mesh.normals is None and len(mesh.faces):
            return mesh.vertices, vertex_normals(mesh.vertices, mesh.faces), mesh.faces
        return mesh.vertices, mesh.normals, mesh.faces

    return Scans([str(path) for path in paths], load)


@checked
def save_clouds(path: str | Path, clouds: Sequence[Cloud | Scan]) -> None:
    """Write clouds as one `.npz` for `read_clouds`; points with weight zero are left out.

    **Raises:** `InputError` if there are no clouds, or the file cannot be written.
    """
    if len(clouds) == 0:
        raise InputError("save_clouds: `clouds` is empty; expected one cloud at least.")
    points, normals = [], []
    for cloud in clouds:
        used = np.asarray(cloud.weights) > 0 if isinstance(cloud, Cloud) else np.ones(len(cloud.points), bool)
        points.append(np.asarray(cloud.points)[used])
        normals.append(
            np.zeros_like(points[-1]) if cloud.normals is None else np.asarray(cloud.normals)[used]
        )
    offsets = np.cumsum([0, *(len(part) for part in points)])
    with atomic_path(path) as temporary, open(temporary, "wb") as file:
        np.savez_compressed(
            file,
            points=np.concatenate(points).astype(np.float32),
            normals=np.concatenate(normals).astype(np.float32),
            offsets=offsets,
        )


def _arrays(path: Path, first: int | None, last: int | None, metres: float) -> Scans:
    arrays = load_arrays(path, lambda name: name in _ARRAYS)
    names = array_names(path)
    faces, offsets = arrays.get("faces"), arrays.get("offsets")
    points, normals = arrays.get("points", arrays.get("vertices")), arrays.get("normals")
    if points is None or "skin" in names:
        raise wrong_arrays_error(path, "clouds, an array 'points' (F, N, 3) or 'vertices' (F, V, 3)")
    if points.dtype.kind not in "fiu":
        raise InputError(
            f"{path}: '{'points' if 'points' in arrays else 'vertices'}' has the type {points.dtype}; expected numbers, (F, N, 3)."
        )
    if offsets is None and points.ndim == 2:
        offsets = np.array([0, len(points)])
    if points.ndim != (3 if offsets is None else 2) or points.shape[-1] != 3:
        wanted = "(F, N, 3)" if offsets is None else "(T, 3) with offsets"
        raise InputError(f"{path}: the points have the shape {points.shape}; expected {wanted}.")
    if normals is not None and (normals.shape != points.shape or normals.dtype.kind not in "fiu"):
        raise InputError(
            f"{path}: the normals have the shape {normals.shape} and the type {normals.dtype}; expected numbers of the "
            f"shape of the points, {points.shape}."
        )
    if offsets is not None and (offsets.ndim != 1 or offsets.dtype.kind not in "iu" or not len(offsets)):
        raise InputError(
            f"{path}: the offsets have the shape {offsets.shape} and the type {offsets.dtype}; expected whole numbers, "
            "(F + 1,)."
        )
    if offsets is not None and not (
        offsets[0] == 0 and offsets[-1] == len(points) and (offsets[1:] >= offsets[:-1]).all()
    ):
        raise InputError(
            f"{path}: the offsets do not increase from 0 to the number of points, {len(points)}; write the file again."
        )
    if faces is not None:
        if faces.ndim != 2 or faces.shape[1] != 3 or faces.dtype.kind not in "iu":
            raise InputError(
                f"{path}: the faces have the shape {faces.shape} and the type {faces.dtype}; expected whole numbers, (T, 3)."
            )
        # the same for all frames, so checked against the frame with the fewest points
        least = points.shape[1] if offsets is None else np.diff(offsets).min(initial=len(points))
        check_face_indices(faces, int(least), path)
    count = len(points) if offsets is None else len(offsets) - 1
    if count > max(len(points), 1):
        raise InputError(
            f"{path}: the file has {count} frames but only {len(points)} points; remove empty frames."
        )
    frames = select_range(list(range(count)), first, last, str(path))

    def load(index: int):
        frame = frames[index]
        rows = frame if offsets is None else slice(offsets[frame], offsets[frame + 1])
        here = np.asarray(points[rows], float) * metres
        own = None if normals is None else _zero_invalid_normals(np.asarray(normals[rows], float))
        if faces is None:
            return here, own, NO_FACES
        # checked before normals are computed
        check_points(here, f"{path}[{frame}]")
        return here, vertex_normals(here, faces) if own is None else own, faces

    return Scans([f"{path}[{frame}]" for frame in frames], load)


def _zero_invalid_normals(normals: Float[np.ndarray, "N 3"]) -> Float[np.ndarray, "N 3"]:
    """Set normals that are not finite or too large to zero, which marks them as unknown."""
    return np.where((np.abs(normals) <= MAX_NUMBER).all(1, keepdims=True), normals, 0.0)
