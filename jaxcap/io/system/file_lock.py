"""Locks of open files and folders, which the operating system releases when the process ends."""

import errno
import os
from pathlib import Path

#: errors of file systems without locks, such as some network drives
_NO_LOCK_ERRORS = (errno.ENOLCK, errno.ENOSYS, errno.ENOTSUP, errno.EOPNOTSUPP)
#: the byte that Windows locks, after the text, which others must be able to read
_LOCK_OFFSET = 1 << 30


def lock_open_file(file: int) -> bool | None:
    """Lock an open file without waiting.

    False if another process, or another part of this one, has the lock; None if the file system has no locks.
    """
    try:
        if os.name == "nt":
            import msvcrt

            os.lseek(file, _LOCK_OFFSET, os.SEEK_SET)
            msvcrt.locking(file, msvcrt.LK_NBLCK, 1)  # pyright: ignore[reportAttributeAccessIssue]
            os.lseek(file, 0, os.SEEK_SET)
        else:
            import fcntl

            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        if error.errno in _NO_LOCK_ERRORS:
            return None
        if error.errno in (errno.EAGAIN, errno.EACCES, errno.EDEADLK):
            return False
        os.close(file)
        raise
    return True


def is_file_at(file: int, path: str | Path) -> bool:
    """Check that an open file is still the one at a path, and was not removed by a run that ended."""
    try:
        return os.path.samestat(os.fstat(file), os.stat(path, follow_symlinks=False))
    except FileNotFoundError:
        return False


def lock_folder(folder: str | Path) -> int | None:
    """Open and lock a folder.

    None if it does not exist, another process has the lock, or folders cannot be locked, as on Windows.
    """
    if os.name == "nt":
        return None
    try:
        file = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
    except OSError:
        return None
    if lock_open_file(file) and is_file_at(file, folder):
        return file
    os.close(file)
    return None
