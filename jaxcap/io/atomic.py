"""Files that appear whole or not at all."""

import errno
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from ..errors import InputError

#: no space on the device, no more for this user, no larger files
FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)


@contextmanager
def replacing(path: str | Path) -> Iterator[Path]:
    """A path beside `path` to write to; it takes the place of `path` when the block ends
    well, and vanishes when it does not.

    **Raises:** `InputError` where the folder cannot be written to, or is full: what was at `path` is there still.
    """
    path = Path(path)
    beside = path.with_name(f".{path.stem}.{os.getpid()}{path.suffix}")
    try:
        yield beside
        os.replace(beside, path)
    except OSError as error:
        mend = "free some space there" if error.errno in FULL else "give a path in a writable folder"
        raise InputError(f"{path}: cannot be written ({error.strerror or error}); {mend}.") from None
    finally:
        beside.unlink(missing_ok=True)


def write_text(path: str | Path, text: str) -> None:
    """Write a text file whole. Raises `InputError` where it cannot be written."""
    with replacing(path) as beside:
        beside.write_text(text, encoding="utf-8")
