"""Checks of output files: write access, and no replacement without --overwrite."""

from collections.abc import Iterable
from pathlib import Path

from ..errors import InputError
from ..io.registry import MOTION_WRITERS
from .console.console import say


def check_absent(paths: Iterable[Path], overwrite: bool) -> None:
    """Check that none of the files exists, or they may be replaced. Raises `InputError`."""
    there = [path for path in paths if path.exists()]
    if there and not overwrite:
        raise InputError(f"{there[0]}: this file already exists; give --overwrite to replace it.")


def check_parent(path: Path) -> None:
    """Check that a file's folder exists. Raises `InputError`."""
    if not path.absolute().parent.is_dir():
        raise InputError(f"{path}: its folder does not exist; make it first.")


def check_new(path: Path | None, overwrite: bool) -> None:
    """Check that a file can be made at a path, or replaced. Raises `InputError`."""
    if path is None:
        return
    if path.is_dir():
        raise InputError(f"{path}: this is a folder; give the name of a file.")
    check_absent([path], overwrite)
    check_parent(path)


def check_motion(path: Path, overwrite: bool) -> None:
    """Check that a motion can be written to a path. Raises `InputError`."""
    if path.suffix.lower() not in MOTION_WRITERS:
        raise InputError(
            f"{path}: motions are not written as '{path.suffix}' files; use {', '.join(MOTION_WRITERS)}."
        )
    check_new(path, overwrite)


def check_npz(path: Path, overwrite: bool, what: str = "a motion") -> None:
    """Check that an `.npz` can be written to a path. Raises `InputError`."""
    if path.suffix.lower() != ".npz":
        raise InputError(f"{path}: {what} is written as .npz; give a name that ends in .npz.")
    check_new(path, overwrite)


def is_run_complete(results: Iterable[Path], checkpoint: Path) -> bool:
    """Check if a run to resume has all its `results`, and print a line if so; `checkpoint` is the checkpoint of an
    unfinished run."""
    results = list(results)
    if checkpoint.exists() or not all(path.is_file() for path in results):
        return False
    say(
        f"{results[0]}: this run is already complete; its options and input files are not compared with those "
        "given now, and --overwrite begins it anew"
    )
    return True


def names_folder(path: Path) -> bool:
    """Test if a path names a folder: an existing one, or one without a suffix, where a number such as that of `P1.5` is none."""
    return path.is_dir() or not path.suffix or path.suffix[1:].isdigit()


def make_folder(folder: Path) -> None:
    """Make a folder and its parents. Raises `InputError` if that fails."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(
            f"{folder}: this folder cannot be created ({error.strerror}); give another one."
        ) from None
