"""An append-only file of records of one size, so that a run that was killed can go on.

    8 bytes     JAXCAPJ1
    4 bytes     length of the header, little endian
    header      JSON: what the run was begun with, and the number of floats in a record
    records     float64 little endian, each with a CRC-32 behind it

A record that was torn by the end of the program is told by its length or its sum, and is
written anew.
"""

import json
import struct
import zlib
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from jaxtyping import Float

from ..errors import InputError
from .atomic import replacing

MAGIC = b"JAXCAPJ1"


class Journal:
    """Records of `width` floats at the end of a file. Make one by `begin` or `resume`."""

    def __init__(self, path: Path, width: int, records: Float[np.ndarray, "N width"], start: int):
        self.path, self.width, self.records = path, width, records
        self._file = open(path, "r+b")  # noqa: SIM115 - closed by `close`
        self._file.truncate(start)
        self._file.seek(start)

    def append(self, record: Float[np.ndarray, "width"]) -> None:
        """Write one record and hand it to the operating system: it outlives this program."""
        data = np.asarray(record, "<f8").tobytes()
        if len(data) != 8 * self.width:
            raise ValueError(f"A record of this journal has {self.width} numbers, not {len(data) // 8}.")
        self._file.write(data + struct.pack("<I", zlib.crc32(data)))
        self._file.flush()

    def close(self) -> None:
        self._file.close()

    def __enter__(self) -> "Journal":
        return self

    def __exit__(self, *_) -> None:
        self.close()


def begin_journal(path: str | Path, header: Mapping[str, object], width: int) -> Journal:
    """A new journal, in place of one that is there. Raises `InputError` where it cannot be written."""
    path = Path(path)
    text = json.dumps({"width": width, **header}).encode()
    data = MAGIC + struct.pack("<I", len(text)) + text
    with replacing(path) as temporary:
        temporary.write_bytes(data)
    try:
        return Journal(path, width, np.zeros((0, width)), len(data))
    except OSError as error:
        raise InputError(
            f"{path}: cannot be written ({error.strerror}); give a path in a writable folder."
        ) from None


def read_header(path: str | Path) -> dict[str, object]:
    """What a journal was begun with. Raises `InputError` where the file is no journal."""
    return _read(Path(path))[0]


def resume_journal(path: str | Path, header: Mapping[str, object]) -> Journal:
    """A journal that goes on behind its last whole record, with the whole ones in `records`.

    **Raises:** `InputError` where the file is no journal, or was begun with another `header`:
    the first difference is told.
    """
    path = Path(path)
    there, body, start = _read(path)
    width = int(str(there.pop("width")))
    check_same_run(path, there, header)
    whole = _records(body, width)
    return Journal(path, width, whole, start + (8 * width + 4) * len(whole))


def read_records(path: str | Path, after: int = 0) -> Float[np.ndarray, "N width"]:
    """The whole records behind the first `after`, while another program writes the journal: one that is
    half written is not there yet. Raises `InputError` where the file is no journal."""
    there, body, _ = _read(Path(path))
    width = int(str(there["width"]))
    return _records(body[(8 * width + 4) * after :], width)


def check_same_run(path: Path, there: Mapping[str, object], header: Mapping[str, object]) -> None:
    """That what a file was begun with is what a run is to go on with.

    **Raises:** `InputError` that tells the first difference.
    """
    # as JSON has it: tuples are lists there
    now = json.loads(json.dumps(header))
    for name in [*now, *there]:
        if there.get(name) != now.get(name):
            raise InputError(
                f"{path}: this run was begun with {name} {_short(there.get(name))}, not {_short(now.get(name))}; "
                "resume it with the same settings, or overwrite it."
            )


def _records(body: bytes, width: int) -> Float[np.ndarray, "N width"]:
    """The records up to the first that is torn."""
    size = 8 * width + 4
    records = []
    for at in range(0, len(body) - size + 1, size):
        data, (total,) = body[at : at + size - 4], struct.unpack("<I", body[at + size - 4 : at + size])
        if zlib.crc32(data) != total:
            break
        records.append(np.frombuffer(data, "<f8"))
    return np.stack(records) if records else np.zeros((0, width))


def _read(path: Path) -> tuple[dict[str, object], bytes, int]:
    """Header, the bytes behind it, and where they start."""
    try:
        data = path.read_bytes()
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}).") from None
    try:
        if data[:8] != MAGIC:
            raise ValueError
        start = 12 + struct.unpack("<I", data[8:12])[0]
        header = json.loads(data[12:start])
        if len(data) < start or not isinstance(header.get("width"), int):
            raise ValueError
    except (ValueError, struct.error, AttributeError):
        raise InputError(f"{path}: this is not the journal of a run; overwrite it.") from None
    return header, data[start:], start


def _short(value: object) -> str:
    text = str(value)
    return text if len(text) <= 40 else text[:16] + "..."
