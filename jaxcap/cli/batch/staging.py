"""The folder in which a job writes, next to its outputs, until it is done: outputs appear whole or not at all."""

import contextlib
import json
import os
import shutil
import tempfile
from collections.abc import Collection, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from ...errors import InputError
from ...io.system.atomic import DISK_FULL_ERRORS, write_text
from ...io.system.run_lock import FOLDER_LOCK, run_lock
from .file_fields import output_paths, replace_outputs
from .jobs import Job
from .urls import exists, folders_of, is_url, place_of, upload

#: beginning of the name of the folder of a job, and the files in it that count the attempts and list the outputs to be moved
PREFIX, ATTEMPTS_FILE, MOVES_FILE = ".jaxcap-batch-", ".attempts", ".moves"


class Staging(NamedTuple):
    """The folders in which a job writes."""

    #: by the folder of the outputs; those at URLs have one each, on this computer
    folders: Mapping[str, Path]
    #: URLs of outputs by their paths on this computer
    uploads: Mapping[Path, str]
    #: the job as it writes there
    command: Any
    #: number of this attempt, from 1; later ones find the files of earlier ones
    attempt: int

    def destination(self, text: str) -> str:
        """Replace the folders in a text by those of the outputs."""
        for path, url in self.uploads.items():
            text = text.replace(str(path), url)
        for folder, staging in self.folders.items():
            text = text.replace(f"{staging}{os.sep}", "" if folder == "." else f"{folder}{os.sep}")
        return text


def staging_folder(job: Job, folder: Path) -> Path:
    """Return the folder in which a job writes the outputs of a folder."""
    return folder / f"{PREFIX}{job.key}"


def remove_earlier(earlier: Iterable[str], written: Iterable[str]) -> None:
    """Remove the files of an earlier run of a job that it has not written again; those at URLs remain."""
    places = set(map(place_of, written))
    for output in earlier:
        if not is_url(output) and place_of(output) not in places:
            with contextlib.suppress(OSError):
                os.unlink(output)


def begun_outputs(job: Job) -> list[str]:
    """List the outputs that an attempt of a job had begun to move when it was killed."""
    paths = output_paths(job.verb, job.command)
    folders = {staging_folder(job, path.parent) for path in paths if str(path) not in job.urls}
    return [output for folder in sorted(folders) for output in _listed_moves(folder)]


@contextlib.contextmanager
def open_staging(job: Job) -> Iterator[Staging]:
    """Make and lock the folders of a job; they are removed if the block succeeds, and remain for the next attempt otherwise.

    **Raises:** `InputError` if a folder cannot be made, or another process runs the same job.
    """
    folders: dict[str, Path] = {}
    uploads: dict[Path, str] = {}
    with contextlib.ExitStack() as stack:

        def place(path: Path) -> Path:
            if str(path) in job.urls:
                folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="jaxcap-")))
                uploads[folder / path.name] = job.urls[str(path)]
                return folder / path.name
            name = str(path.parent)
            folders.setdefault(name, staging_folder(job, path.parent))
            return folders[name] / path.name

        command = replace_outputs(job.verb, job.command, place)
        for folder in folders.values():
            _make(folder)
        stack.enter_context(run_lock(*folders.values()))
        yield Staging(folders, uploads, command, max(map(_count, folders.values()), default=1))
        for folder in folders.values():
            shutil.rmtree(folder, ignore_errors=True)


def empty(staging: Staging) -> None:
    """Remove the files of earlier attempts, which cannot be continued."""
    for folder in staging.folders.values():
        for entry in _entries(folder):
            shutil.rmtree(entry) if entry.is_dir() else entry.unlink()


def publish(staging: Staging, replace: bool, owned: Iterable[str] = ()) -> list[str]:
    """Move the outputs to their folders; return their paths and URLs.

    A file is replaced at once, and so is a new folder; the files of a folder that exists are moved one by one.

    **Arguments:** `replace` allows the replacement of all outputs that exist; `owned` are those of earlier runs, which are always
    replaced, as are those that a killed attempt had begun to move.

    **Raises:** `InputError` if an output exists that may not be replaced, or it cannot be written; then nothing is moved,
    unless the disk is full.
    """
    moves = [
        (entry, Path(folder) / entry.name)
        for folder, there in staging.folders.items()
        for entry in _entries(there)
    ]
    files = [pair for entry, target in moves for pair in _files(entry, target)]
    begun = [output for folder in staging.folders.values() for output in _listed_moves(folder)]
    if not replace:
        _check_absent(staging, files, {place_of(output) for output in (*owned, *begun)})
    destinations = [*(str(target) for _, target in files), *staging.uploads.values()]
    for folder in staging.folders.values():
        write_text(folder / MOVES_FILE, json.dumps([*begun, *destinations]))
    try:
        for entry, target in moves:
            if entry.is_dir() and target.is_dir():
                for file, place in _files(entry, target):
                    place.parent.mkdir(parents=True, exist_ok=True)
                    os.replace(file, place)
            else:
                os.replace(entry, target)
    except OSError as error:
        mend = (
            "free some disk space" if error.errno in DISK_FULL_ERRORS else "give a path in a writable folder"
        )
        raise InputError(
            f"{error.filename2 or error.filename}: cannot be written ({error.strerror}); {mend}."
        ) from None
    sent = [url for path, place in staging.uploads.items() if path.exists() for url in upload(path, place)]
    return [str(target) for _, target in files] + sent


def _check_absent(staging: Staging, files: list[tuple[Path, Path]], owned: Collection[str]) -> None:
    """Check that no output exists, except those in the places that are `owned`. Raises `InputError`."""
    found = [str(target) for _, target in files if target.exists() and place_of(str(target)) not in owned]
    for url in filter(exists, staging.uploads.values()):
        # a folder is owned by one of its files
        if not any(place == place_of(url) or place_of(url) in folders_of(place) for place in owned):
            found.append(url)
    if found:
        raise InputError(
            f"{found[0]}: this file already exists; give --overwrite to the batch to replace it."
        )


def _listed_moves(folder: Path) -> list[str]:
    """Read the outputs that an attempt had begun to move; empty if there are none."""
    try:
        found = json.loads((folder / MOVES_FILE).read_text("utf-8"))
    except (OSError, ValueError):
        return []
    return [output for output in found if isinstance(output, str)] if isinstance(found, list) else []


def _entries(folder: Path) -> list[Path]:
    """List the files and folders of a job, without the files of the batch itself."""
    own = (FOLDER_LOCK, ATTEMPTS_FILE, MOVES_FILE)
    return sorted(entry for entry in folder.iterdir() if entry.name not in own)


def _files(entry: Path, target: Path) -> list[tuple[Path, Path]]:
    """List the files of an output with their destinations."""
    if not entry.is_dir():
        return [(entry, target)]
    found = sorted(path for path in entry.rglob("*") if path.is_file())
    return [(path, target / path.relative_to(entry)) for path in found]


def _make(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(
            f"{folder.parent}: this folder cannot be written to ({error.strerror}); give another one."
        ) from None


def _count(folder: Path) -> int:
    """Count an attempt, in a file of the folder."""
    path = folder / ATTEMPTS_FILE
    try:
        attempt = int(path.read_text()) + 1 if path.is_file() else 1
    except ValueError:
        # killed while the count was written
        attempt = 2
    path.write_text(str(attempt))
    return attempt
