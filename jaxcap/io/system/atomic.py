"""Atomic writes of files: a file is complete or not there."""

import errno
import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from ...errors import InputError
from .file_lock import lock_folder

#: no space on the device, quota exceeded, file too large
DISK_FULL_ERRORS = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
#: suffix of temporary folders
_TEMPORARY_SUFFIX = ".unfinished"


@contextmanager
def atomic_path(path: str | Path) -> Iterator[Path]:
    """Yield a temporary path; rename it to `path` if the block succeeds, remove it otherwise.

    The temporary file has the name of `path`, in a new folder next to it that only this user can enter
    (`mkdtemp`: a random name, never a symbolic link). So threads and processes that write the same path never
    share a file, whatever library writes it, and the file has the permissions of any new file. The last one
    to finish wins.

    **Raises:** `InputError` if the folder cannot be written to or is full; an existing file at `path` is not
    changed.
    """
    path = Path(path)
    folder = lock = None
    try:
        while True:
            # file systems limit the length of names, so only the beginning is repeated
            folder = tempfile.mkdtemp(_TEMPORARY_SUFFIX, f".{path.name[:64]}.", path.parent)
            # the lock shows `remove_unfinished` that the folder is in use
            lock = lock_folder(folder)
            if os.path.isdir(folder):
                break
        temporary = Path(folder) / path.name
        yield temporary
        os.replace(temporary, path)
    except OSError as error:
        mend = (
            "free some disk space" if error.errno in DISK_FULL_ERRORS else "give a path in a writable folder"
        )
        raise InputError(f"{path}: cannot be written ({error.strerror or error}); {mend}.") from None
    finally:
        if folder is not None:
            shutil.rmtree(folder, ignore_errors=True)
        if lock is not None:
            os.close(lock)


def remove_unfinished(path: str | Path) -> None:
    """Remove temporary files that killed programs left for `path`, or for all files in it if it is a folder.

    Files that a program is still writing are locked and stay. All stay if folders cannot be locked.
    """
    path = Path(path)
    folder, begin = (path, ".") if path.is_dir() else (path.parent, f".{path.name[:64]}.")
    for there in folder.glob(f".*{_TEMPORARY_SUFFIX}"):
        lock = lock_folder(there) if there.name.startswith(begin) else None
        if lock is not None:
            shutil.rmtree(there, ignore_errors=True)
            os.close(lock)


def write_text(path: str | Path, text: str) -> None:
    """Write a text file atomically. Raises `InputError` if it cannot be written."""
    with atomic_path(path) as temporary:
        temporary.write_text(text, encoding="utf-8")
