"""The files of a sequence, from a pattern, a folder, a glob, one file, or several."""

import glob
import itertools
import re
from collections.abc import Sequence
from pathlib import Path

from ...errors import InputError
from ..kinds import wrong_kind_error
from ..meshes.mesh import SUFFIXES

#: the number in a printf pattern
_NUMBER = re.compile(r"%0?\d*d")


def find_files(
    source: str | Path,
    first: int | None = None,
    last: int | None = None,
    *,
    check_gaps: bool = True,
    extra_suffixes: Sequence[str] = (),
) -> list[Path]:
    """Find mesh files in the order of the numbers in their names.

    **Arguments:** `source` is a printf pattern (`cloud_%03d.off`), a glob, a folder, or one file. `first` and
    `last`, both included, are the numbers in a pattern, and otherwise files counted from 0. With `check_gaps`, no
    number may be missing. `extra_suffixes` are suffixes, besides those of meshes, that are accepted.

    **Raises:** `InputError` if nothing is found, or a number is missing.
    """
    text = str(source)
    if _NUMBER.search(text):
        return _pattern(text, first, last)
    if Path(text).is_dir():
        found = _folder(Path(text), (*SUFFIXES, *extra_suffixes))
    elif glob.has_magic(text) and not Path(text).is_file():
        found = sorted((Path(path) for path in glob.glob(text)), key=natural_sort_key)
        if not found:
            raise InputError(f"{text}: no file matches this pattern; check the path.")
    else:
        if not Path(text).is_file():
            raise wrong_kind_error(text, "a mesh or a cloud", (*SUFFIXES, *extra_suffixes))
        found = [Path(text)]
    for path in found:
        if path.suffix.lower() not in (*SUFFIXES, *extra_suffixes):
            raise wrong_kind_error(path, "a mesh or a cloud", (*SUFFIXES, *extra_suffixes))
    return select_range(_check_no_gaps(found) if check_gaps else found, first, last, text)


def order_files(
    sources: Sequence[str | Path], first: int | None = None, last: int | None = None
) -> list[Path]:
    """Order several mesh files as a quoted glob would: by the numbers in their names.

    A shell sorts by characters, with 10 before 2. `first` and `last` as in `find_files`.

    **Raises:** `InputError` if a file is not a mesh file or is given twice, or a number is missing.
    """
    for source in sources:
        _check_single_frame(Path(source), len(sources))
    paths = sorted(map(Path, sources), key=natural_sort_key)
    for path, after in itertools.pairwise(paths):
        if path == after:
            raise InputError(f"{path}: this file is given twice; each file is one frame.")
    return select_range(_check_no_gaps(paths), first, last, f"{paths[0]} to {paths[-1].name}")


def select_range(items: list, first: int | None, last: int | None, where: str) -> list:
    """Return items `first` to `last`, both included. Raises `InputError` if they do not exist."""
    start, end = first or 0, len(items) - 1 if last is None else last
    if not items:
        raise InputError(f"{where}: there are no frames; expected at least one.")
    if not 0 <= start <= end < len(items):
        raise InputError(
            f"{where}: the frames are 0 to {len(items) - 1}; `first` is {start} and `last` is {end}; give numbers from 0 to "
            f"{len(items) - 1}."
        )
    return items[start : end + 1]


def _check_single_frame(path: Path, count: int) -> None:
    """Check that a file is a single frame. Raises `InputError`."""
    text, suffix = str(path), path.suffix.lower()
    many = {"a folder": path.is_dir(), "a pattern": bool(glob.has_magic(text) or _NUMBER.search(text))}
    if not path.is_file():
        found = [what for what, here in many.items() if here]
        if not found:
            raise InputError(f"{path}: there is no such file; check the path.")
        raise InputError(
            f"{path}: this is {found[0]} among {count} sources; give it as the only source, or give files only."
        )
    if suffix == ".npz":
        raise InputError(f"{path}: an .npz contains a whole sequence; give it as the only source.")
    if suffix not in SUFFIXES:
        raise wrong_kind_error(path, "a mesh or a cloud", SUFFIXES)


def numbered_path(pattern: Path, number: int) -> Path | None:
    """Return the path of a file of a printf pattern, None if its name is no pattern."""
    match = _NUMBER.search(pattern.name)
    if match is None:
        return None
    return pattern.with_name(pattern.name[: match.start()] + match[0] % number + pattern.name[match.end() :])


def _pattern(text: str, first: int | None, last: int | None) -> list[Path]:
    """Find the files of a printf pattern. Raises `InputError` if one is missing."""
    match = _NUMBER.search(text)
    assert match is not None
    folder, name = Path(text).parent, Path(text).name
    if "%" not in name:
        raise InputError(
            f"{text}: the number is in the name of the folder; expected it in the name of the file."
        )
    before, after = _NUMBER.split(name, maxsplit=1)
    fits = re.compile(re.escape(before) + r"(\d+)" + re.escape(after) + "$")
    there = sorted(
        int(m[1]) for path in (folder.iterdir() if folder.is_dir() else []) if (m := fits.match(path.name))
    )
    start = first if first is not None else (there[0] if there else 0)
    end = last if last is not None else (there[-1] if there else start)
    if not there or end < start:
        raise InputError(
            f"{text}: no files have numbers from {first or 0} on; check the path and the numbers."
        )
    paths = []
    for number in range(start, end + 1):
        path = folder / (before + match[0] % number + after)
        if not path.is_file():
            raise InputError(
                f"{path}: this file is missing in the sequence {text} from {start} to {end}; add it, or change the numbers."
            )
        paths.append(path)
    return paths


def _folder(folder: Path, suffixes_read: Sequence[str]) -> list[Path]:
    paths = sorted(
        (p for p in folder.iterdir() if p.suffix.lower() in suffixes_read and p.is_file()),
        key=natural_sort_key,
    )
    suffixes = sorted({path.suffix.lower() for path in paths})
    if not paths:
        raise InputError(
            f"{folder}: the folder contains no clouds or meshes ({', '.join(suffixes_read)}); `jaxcap info {folder}` "
            "describes its contents."
        )
    if len(suffixes) > 1:
        raise InputError(
            f"{folder}: the folder contains {' and '.join(suffixes)} files; select one type, as in '*{suffixes[0]}'."
        )
    return paths


def _check_no_gaps(paths: list[Path]) -> list[Path]:
    """Check that no file is missing among names that differ in one number, and return the paths.

    If a gap between numbers is not a multiple of the smallest one, the numbers are no frame counts but, for
    example, times of a clock; they are not checked. Raises `InputError`.
    """
    parts = [re.match(r"(.*?)(\d+)(\D*)$", path.name) for path in paths]
    if len(paths) < 3 or not all(parts) or len({(m[1], m[3]) for m in parts if m}) > 1:
        return paths
    numbers = [int(m[2]) for m in parts if m]
    gaps = [after - here for here, after in itertools.pairwise(numbers)]
    step = min(gaps)
    if step <= 0 or any(gap % step for gap in gaps):
        return paths
    for path, here, after in zip(paths, numbers, numbers[1:], strict=False):
        if after - here != step:
            raise InputError(
                f"{path}: number {here + step} is missing after this file; the next one is {after}."
            )
    return paths


def natural_sort_key(path: Path) -> list:
    """Return a sort key that puts 2 before 10."""
    return [
        (int(word), "") if word.isdigit() else (-1, word) for word in re.split(r"(\d+)", str(path)) if word
    ]
