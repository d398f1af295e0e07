"""Sequences of clouds: numbered files, folders, globs, or one `.npz`; read when asked for."""

import glob
import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple, overload

import numpy as np
from jaxtyping import Float

from ..errors import InputError
from .mesh import SUFFIXES, check_points, read_mesh, vertex_normals
from .npz import load_arrays
from .text import unit_scale


class Scan(NamedTuple):
    """One frame, metres. Normals are the file's own or those of its faces, else None."""

    name: str
    points: Float[np.ndarray, "N 3"]
    normals: Float[np.ndarray, "N 3"] | None


class Scans(Sequence):
    """A sequence of clouds that loads each one when it is asked for; `names` and `len` cost
    nothing."""

    def __init__(self, names: Sequence[str], load):
        self.names, self._load = tuple(names), load

    def __len__(self) -> int:
        return len(self.names)

    @overload
    def __getitem__(self, frame: int) -> Scan: ...
    @overload
    def __getitem__(self, frame: slice) -> "Scans": ...
    def __getitem__(self, frame):
        if isinstance(frame, slice):
            numbers = range(len(self))[frame]
            return Scans([self.names[i] for i in numbers], lambda i: self._load(numbers[i]))
        return self._scan(range(len(self))[frame])

    def _scan(self, frame: int) -> Scan:
        points, normals = self._load(frame)
        check_points(points, self.names[frame])
        return Scan(self.names[frame], points, normals)

    def __iter__(self) -> Iterator[Scan]:
        return (self._scan(frame) for frame in range(len(self)))


def read_clouds(
    source: str | Path, first: int | None = None, last: int | None = None, unit: str | float = "m"
) -> Scans:
    """A sequence of clouds.

    **Arguments:** `source` is a printf pattern (`cloud_%03d.off`), a glob, a folder, one
    mesh file, or an `.npz` with `points (F, N, 3)`, or `points (T, 3)` and `offsets (F + 1,)`
    for clouds of different sizes (`normals` alike), or `vertices (F, V, 3)` and
    `faces (T, 3)`. `first` and `last`, both included, are the numbers in a pattern, and else
    frames counted from 0. `unit` as in `read_mesh`.

    **Raises:** `InputError` where nothing is found, a number is missing in a numbered
    sequence, or (when it is read) a cloud is wrong.
    """
    metres, text = unit_scale(unit), str(source)
    if re.search(r"%0?\d*d", text):
        paths = _pattern(text, first, last)
    elif Path(text).is_dir():
        paths = _cut(_whole(_folder(Path(text))), first, last, text)
    elif Path(text).suffix.lower() == ".npz":
        return _arrays(Path(text), first, last, metres)
    elif glob.has_magic(text) and not Path(text).is_file():
        found = sorted((Path(path) for path in glob.glob(text)), key=_natural)
        if not found:
            raise InputError(f"{text}: no file fits this pattern; check the path.")
        paths = _cut(_whole(found), first, last, text)
    else:
        if not Path(text).is_file():
            raise InputError(f"{text}: there is no such file or folder; check the path.")
        paths = _cut([Path(text)], first, last, text)

    def load(frame: int):
        mesh = read_mesh(paths[frame], unit)
        if mesh.normals is None and len(mesh.faces):
            return mesh.vertices, vertex_normals(mesh.vertices, mesh.faces)
        return mesh.vertices, mesh.normals

    return Scans([str(path) for path in paths], load)


def _pattern(text: str, first: int | None, last: int | None) -> list[Path]:
    """The files of a printf pattern, none left out."""
    match = re.search(r"%(0?)(\d*)d", text)
    assert match is not None
    folder, name = Path(text).parent, Path(text).name
    if "%" not in name:
        raise InputError(f"{text}: the number must be in the file's name, not in the folder's.")
    before, after = re.split(r"%0?\d*d", name, maxsplit=1)
    fits = re.compile(re.escape(before) + r"(\d+)" + re.escape(after) + "$")
    there = sorted(
        int(m[1]) for path in (folder.iterdir() if folder.is_dir() else []) if (m := fits.match(path.name))
    )
    start = first if first is not None else (there[0] if there else 0)
    end = last if last is not None else (there[-1] if there else start)
    if not there or end < start:
        raise InputError(
            f"{text}: there are no files with numbers from {first or 0} on; check the path and the numbers."
        )
    paths = []
    for number in range(start, end + 1):
        path = folder / (before + match[0] % number + after)
        if not path.is_file():
            raise InputError(f"{path}: this file is missing in the sequence {text} from {start} to {end}.")
        paths.append(path)
    return paths


def _folder(folder: Path) -> list[Path]:
    paths = sorted(
        (p for p in folder.iterdir() if p.suffix.lower() in SUFFIXES and p.is_file()), key=_natural
    )
    suffixes = sorted({path.suffix.lower() for path in paths})
    if not paths:
        raise InputError(
            f"{folder}: there are no clouds in this folder; it takes {', '.join(SUFFIXES)} files."
        )
    if len(suffixes) > 1:
        raise InputError(
            f"{folder}: there are {' and '.join(suffixes)} files in this folder; say which, as in '*{suffixes[0]}'."
        )
    return paths


def _whole(paths: list[Path]) -> list[Path]:
    """The same paths, where names that differ in one number leave none out."""
    parts = [re.match(r"(.*?)(\d+)(\D*)$", path.name) for path in paths]
    if len(paths) < 3 or not all(parts) or len({(m[1], m[3]) for m in parts if m}) > 1:
        return paths
    numbers = [int(m[2]) for m in parts if m]
    step = min(np.diff(numbers))
    for path, here, after in zip(paths, numbers, numbers[1:], strict=False):
        if step > 0 and after - here != step:
            raise InputError(
                f"{path}: number {here + step} is missing after this file; the next one is {after}."
            )
    return paths


def _natural(path: Path) -> list:
    """Sorts 2 before 10."""
    return [
        (int(word), "") if word.isdigit() else (-1, word) for word in re.split(r"(\d+)", str(path)) if word
    ]


def _cut(items: list, first: int | None, last: int | None, where: str) -> list:
    start, end = first or 0, len(items) - 1 if last is None else last
    if not 0 <= start <= end < len(items):
        raise InputError(
            f"{where}: there are frames 0 to {len(items) - 1}, but {start} to {end} were asked for."
        )
    return items[start : end + 1]


def _arrays(path: Path, first: int | None, last: int | None, metres: float) -> Scans:
    arrays = load_arrays(path)
    faces, offsets = arrays.get("faces"), arrays.get("offsets")
    points, normals = arrays.get("points", arrays.get("vertices")), arrays.get("normals")
    if points is None or points.dtype.kind not in "fiu":
        raise InputError(
            f"{path}: there is no array 'points' or 'vertices' in it, but {', '.join(arrays) or 'nothing'}."
        )
    if offsets is None and points.ndim == 2:
        offsets = np.array([0, len(points)])
    if points.ndim != (3 if offsets is None else 2) or points.shape[-1] != 3:
        wanted = "(F, N, 3)" if offsets is None else "(T, 3) with offsets"
        raise InputError(f"{path}: the points have the shape {points.shape}; it must be {wanted}.")
    if normals is not None and normals.shape != points.shape:
        raise InputError(f"{path}: the normals have the shape {normals.shape}, the points {points.shape}.")
    if offsets is not None and not (
        offsets[0] == 0 and offsets[-1] == len(points) and (np.diff(offsets) >= 0).all()
    ):
        raise InputError(f"{path}: the offsets must rise from 0 to the number of points, {len(points)}.")
    count = len(points) if offsets is None else len(offsets) - 1
    frames = _cut(list(range(count)), first, last, str(path))

    def load(index: int):
        frame = frames[index]
        rows = frame if offsets is None else slice(offsets[frame], offsets[frame + 1])
        here = np.asarray(points[rows], float) * metres
        if normals is not None:
            return here, np.asarray(normals[rows], float)
        return here, None if faces is None else vertex_normals(here, faces)

    return Scans([f"{path}[{frame}]" for frame in frames], load)
