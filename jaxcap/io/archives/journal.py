"""An append-only file of records of fixed size, from which a killed run can continue.

    8 bytes     JAXCAPJ1
    4 bytes     length of the header, little endian
    header      JSON: the settings of the run, and the number of floats in a record
    records     float64 little endian, each followed by a CRC-32

A record that was torn by the end of the program is detected by its length or its checksum, and is written
again. Records are read in blocks: memory does not grow with their number.
"""

import hashlib
import json
import shutil
import struct
import sys
import warnings
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

import numpy as np
from jaxtyping import Float

from ...errors import InputError
from ..system.atomic import DISK_FULL_ERRORS, atomic_path
from ..text import parse_json

MAGIC = b"JAXCAPJ1"
#: largest number of floats in a record
MAX_RECORD_WIDTH = 1_000_000
#: bytes of records that are read at once
BLOCK = 1 << 22


class Journal:
    """Records of `width` floats at the end of a file. Create one by `create_journal` or `resume_journal`.

    `count` is the number of records in the file, `last` the last record that was there at the start.
    """

    def __init__(
        self,
        path: Path,
        width: int,
        start: int,
        count: int = 0,
        last: Float[np.ndarray, "width"] | None = None,
    ):
        self.path, self.width, self.count, self.last = path, width, count, last
        # unbuffered: data that could not be written must not be written again on close
        self._file = open(path, "r+b", buffering=0)  # noqa: SIM115 - closed by `close`
        end = start + _size(width) * count
        self._file.truncate(end)
        self._file.seek(end)

    def append(self, record: Float[np.ndarray, "width"]) -> None:
        """Write one record and pass it to the operating system, so that it outlives this program.

        **Raises:** `InputError` if the disk is full; the earlier records stay in the file.
        """
        data = np.asarray(record, "<f8").tobytes()
        if len(data) != 8 * self.width:
            raise ValueError(
                f"The record has {len(data) // 8} numbers; expected {self.width}, as in this journal."
            )
        left = memoryview(data + struct.pack("<I", zlib.crc32(data)))
        try:
            while left:
                left = left[self._file.write(left) :]
        except OSError as error:
            mend = "free some disk space" if error.errno in DISK_FULL_ERRORS else "make its folder writable"
            raise InputError(
                f"{self.path}: record {self.count} cannot be written ({error.strerror}); {mend} and resume the run."
            ) from None
        self.count += 1

    def read(self, columns: slice = slice(None)) -> Float[np.ndarray, "N columns"]:
        """Read some columns of all records, with those of this run."""
        return read_records(self.path, columns=columns)

    def close(self) -> None:
        self._file.close()

    def __enter__(self) -> "Journal":
        return self

    def __exit__(self, *_) -> None:
        self.close()


def create_journal(path: str | Path, header: Mapping[str, object], width: int) -> Journal:
    """Create a journal and replace an existing one. Raises `InputError` if it cannot be written."""
    path = Path(path)
    text = json.dumps({"width": width, **header}).encode()
    data = MAGIC + struct.pack("<I", len(text)) + text
    with atomic_path(path) as temporary:
        temporary.write_bytes(data)
    try:
        return Journal(path, width, len(data))
    except OSError as error:
        mend = (
            "free some disk space" if error.errno in DISK_FULL_ERRORS else "give a path in a writable folder"
        )
        raise InputError(f"{path}: cannot be written ({error.strerror}); {mend}.") from None


def read_header(path: str | Path) -> dict[str, object]:
    """Read the header of a journal. Raises `InputError` if the file is no journal."""
    with _open_journal(Path(path)) as (_, header, _):
        return header


def resume_journal(path: str | Path, header: Mapping[str, object], width: int) -> Journal:
    """Open a journal of records of `width` numbers after its last valid record.

    A torn last record is written again. If a record before others is damaged, a warning is given and a copy
    is kept.

    **Raises:** `InputError` if the file is no journal, if it has another `header` (the message gives the
    first difference), or if another version wrote it with records of another width.
    """
    path = Path(path)
    with _open_journal(path) as (file, there, start):
        begun = int(str(there.pop("width")))
        check_same_header(path, there, header)
        if begun != width:
            raise InputError(
                f"{path}: this run was started by another version of jaxcap, with {begun} numbers for each frame; expected "
                f"{width}; finish it with that version, or give --overwrite to start again."
            )
        count, last = 0, None
        for block in _blocks(file, width):
            count, last = count + len(block), block[-1].copy()
        file.seek(0, 2)
        behind = (file.tell() - start) // _size(width) - count
    # the end of the program may tear the last record; damage before other records happened later
    if behind > 1:
        kept = path.with_name(f"{path.name}.damaged")
        with atomic_path(kept) as temporary:
            shutil.copyfile(path, temporary)
        warnings.warn(
            f"{path}: record {count}, counted from 0, is damaged; it and the {behind - 1} records after it are computed again. "
            f"The damaged journal is kept as {kept.name}.",
            stacklevel=2,
        )
    return Journal(path, width, start, count, last)


def read_records(
    path: str | Path, skip: int = 0, columns: slice = slice(None), count: int | None = None
) -> Float[np.ndarray, "N columns"]:
    """Read the valid records after the first `skip`, or some of their columns; at most `count` records.

    Another program may write the journal at the same time; an incomplete record is skipped. Raises
    `InputError` if the file is no journal.
    """
    with _open_journal(Path(path)) as (file, there, start):
        width = int(str(there["width"]))
        file.seek(start + _size(width) * skip)
        blocks = [block[:, columns].copy() for block in _blocks(file, width, count)]
    return np.concatenate([np.zeros((0, width))[:, columns], *blocks])


def count_records(path: str | Path) -> int:
    """Count the records of a journal by its size; another program may write it. Raises `InputError` if the file is no journal."""
    with _open_journal(Path(path)) as (file, there, start):
        return (file.seek(0, 2) - start) // _size(int(str(there["width"])))


def check_same_header(path: Path, stored: Mapping[str, object], header: Mapping[str, object]) -> None:
    """Check that a file has the `header` of the run that is to continue.

    **Raises:** `InputError` with the first difference.
    """
    # a JSON round trip, as tuples become lists
    now = json.loads(json.dumps(header))
    for name in [*now, *stored]:
        if stored.get(name) != now.get(name):
            raise InputError(
                f"{path}: this run was started with {name} {_short(stored.get(name))}, not {_short(now.get(name))}; "
                "resume it with the same settings, or overwrite it."
            )


def hash_file(path: str | Path) -> str:
    """Compute the SHA-256 of a file. Raises `InputError` if it cannot be read."""
    try:
        return hashlib.sha256(Path(path).read_bytes()).hexdigest()
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); check the path.") from None


def hash_files(paths: Mapping[str, Path | None]) -> dict[str, str | None]:
    """Compute the SHA-256 of files by their names in a header; None for those that are not given."""
    return {name: None if path is None else hash_file(path) for name, path in paths.items()}


def _size(width: int) -> int:
    """Return the bytes of a record with its checksum."""
    return 8 * width + 4


def _blocks(file: BinaryIO, width: int, count: int | None = None) -> Iterator[Float[np.ndarray, "N width"]]:
    """Iterate over blocks of records from the current position to the first torn record, or of the next `count` records."""
    size = _size(width)
    record = np.dtype([("numbers", "<f8", (width,)), ("sum", "<u4")])
    left = sys.maxsize if count is None else count
    while data := file.read(min(max(BLOCK // size, 1), left) * size):
        left -= len(data) // size
        block = np.frombuffer(data, record, len(data) // size)
        whole = next(
            (n for n, (numbers, total) in enumerate(block) if zlib.crc32(numbers.tobytes()) != total),
            len(block),
        )
        if whole:
            yield block["numbers"][:whole]
        if whole < len(block) or len(data) % size:
            return


@contextmanager
def _open_journal(path: Path) -> Iterator[tuple[BinaryIO, dict[str, object], int]]:
    """Open a journal; yield the file at its first record, the header, and this position."""
    try:
        file = open(path, "rb")  # noqa: SIM115 - closed below
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); give the journal of a run.") from None
    with file:
        try:
            magic, length = file.read(8), file.read(4)
            if magic != MAGIC:
                raise ValueError
            start = 12 + struct.unpack("<I", length)[0]
            text = file.read(min(start - 12, path.stat().st_size))
            header = parse_json(text, path)
            width = header.get("width") if isinstance(header, dict) else None
            if len(text) < start - 12 or type(width) is not int or not 0 < width <= MAX_RECORD_WIDTH:
                raise ValueError
        except (ValueError, struct.error):
            raise InputError(f"{path}: this is not the journal of a run; overwrite it.") from None
        yield file, header, start


def _short(value: object) -> str:
    text = str(value)
    return text if len(text) <= 40 else text[:16] + "..."
