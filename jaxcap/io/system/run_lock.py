"""A lock that allows one run at a time for an output, released when its process ends for any reason."""

import contextlib
import os
import socket
import warnings
from collections.abc import Iterator
from pathlib import Path

from ...errors import InputError
from .atomic import remove_unfinished
from .file_lock import is_file_at, lock_open_file

#: the lock file of a folder of results
FOLDER_LOCK = ".jaxcap.lock"


@contextlib.contextmanager
def run_lock(*outputs: str | Path) -> Iterator[None]:
    """Lock all outputs of a run, each an existing file or folder, for the duration of the block.

    A lock is a small file, `.jaxcap.lock` in a folder or `.NAME.lock` next to a file, that the operating
    system locks for this process (`flock`; on Windows `locking`). It is released when the process ends, also
    by SIGKILL, and the file is removed when the block ends. Temporary files that killed runs left for the
    outputs are removed; those of active programs are not.

    **Raises:** `InputError` if another run has one of the locks, with its process number, or if a folder
    cannot be written to.
    """
    # sorted and unique, so that two runs with the same outputs never wait for each other
    paths = sorted({Path(path).resolve() for path in outputs})
    with contextlib.ExitStack() as stack:
        for path in paths:
            stack.enter_context(_lock(path))
        for path in paths:
            remove_unfinished(path)
        yield


@contextlib.contextmanager
def _lock(output: Path) -> Iterator[None]:
    path = output / FOLDER_LOCK if output.is_dir() else output.with_name(f".{output.name}.lock")
    file = _take(path, output)
    try:
        os.ftruncate(file, 0)
        os.write(file, f"{os.getpid()} {socket.gethostname()}\n".encode())
        yield
    finally:
        # removed while locked: `_take` of another run sees that its file is gone and opens a new one
        with contextlib.suppress(OSError):
            path.unlink()
        os.close(file)
        if os.name == "nt":
            # Windows does not remove an open file
            with contextlib.suppress(OSError):
                path.unlink()


def _take(path: Path, output: Path) -> int:
    """Open and lock a lock file. Raises `InputError` if another run has it."""
    try:
        while True:
            file = os.open(path, os.O_RDWR | os.O_CREAT | getattr(os, "O_NOFOLLOW", 0), 0o666)
            free = lock_open_file(file)
            if free is None:
                warnings.warn(
                    f"{output}: this file system has no locks; do not start another run with this output before this run ends.",
                    stacklevel=2,
                )
                return file
            if free and is_file_at(file, path):
                return file
            owner = b"" if free else os.read(file, 200)
            os.close(file)
            if not free:
                raise InputError(
                    f"{output}: another run{_describe_owner(owner)} writes to this output; wait until it ends, stop it, or give another output."
                )
    except OSError as error:
        raise InputError(
            f"{path}: the lock of this run cannot be created ({error.strerror or error}); give a path in a writable folder."
        ) from None


def _describe_owner(owner: bytes) -> str:
    """Describe the process that a lock file names, with its computer if that is another one."""
    number, _, computer = owner.decode("utf-8", "replace").strip().partition(" ")
    if not number.isdigit():
        return ""
    return (
        f" (process {number})" if computer == socket.gethostname() else f" (process {number} on {computer})"
    )
