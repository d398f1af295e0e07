"""The folder in which a job writes, next to its outputs, until it is done: outputs appear whole or not at all."""

import contextlib
import os
import shutil
import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from ...errors import InputError
from ...io.system.atomic import DISK_FULL_ERRORS
from ...io.system.run_lock import FOLDER_LOCK, run_lock
from .file_fields import output_paths, replace_outputs
from .jobs import Job
from .urls import exists, upload

#: beginning of the name of the folder of a job, and the file in it that counts the attempts
PREFIX, ATTEMPTS_FILE = ".jaxcap-batch-", ".attempts"


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


def is_begun(job: Job) -> bool:
    """Test if an unfinished attempt of a job left its folders."""
    paths = output_paths(job.verb, job.command)
    return any(staging_folder(job, path.parent).is_dir() for path in paths if str(path) not in job.urls)


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


def publish(staging: Staging, replace: bool) -> list[str]:
    """Move the outputs to their folders; return their paths and URLs.

    A file is replaced at once, and so is a new folder; the files of a folder that exists are moved one by one.

    **Raises:** `InputError` if an output exists and `replace` is False, or it cannot be written; then nothing is moved,
    unless the disk is full.
    """
    moves = [
        (entry, Path(folder) / entry.name)
        for folder, there in staging.folders.items()
        for entry in _entries(there)
    ]
    files = [pair for entry, target in moves for pair in _files(entry, target)]
    taken = [str(target) for _, target in files if target.exists()]
    taken += [url for url in staging.uploads.values() if not replace and exists(url)]
    if taken and not replace:
        raise InputError(
            f"{taken[0]}: this file already exists; give --overwrite to the batch to replace it."
        )
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


def _entries(folder: Path) -> list[Path]:
    """List the files and folders of a job, without the lock and the count of attempts."""
    return sorted(entry for entry in folder.iterdir() if entry.name not in (FOLDER_LOCK, ATTEMPTS_FILE))


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
