"""Checks of the first blocks of a C3D file, as ezc3d reports damage less clearly, or never ends."""

import math
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from ...errors import InputError

#: processor types of the numbers in a file: Intel, DEC, MIPS; integers of the first two are the same
_INTEL, _DEC, _MIPS = 84, 85, 86
#: type of the values of a parameter: floats
_FLOAT = 4


def read_header(path: Path) -> tuple[int, int]:
    """Read the first frame and the frame count of the header.

    Ezc3d reports only the number of frames that it found.

    **Raises:** `InputError` if there is no such file, it is no C3D file, or its header is damaged or cut
    short.
    """
    try:
        raw = path.read_bytes()
    except FileNotFoundError:
        raise InputError(f"{path}: there is no such file; check the path.") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); give a readable file.") from None
    if not raw:
        raise InputError(f"{path}: the file is empty; copy or export it again.")
    if len(raw) < 2 or raw[1] != 0x50:
        raise InputError(f"{path}: this is not a C3D file, or its beginning is damaged; export it as C3D.")
    begin = 512 * (raw[0] - 1)
    # the second letter of a PNG is a P as well
    if len(raw) < max(begin, 512) + 4:
        raise InputError(
            f"{path}: this is not a C3D file, or it is cut short within its header; copy or export it again."
        )
    if begin < 512 or raw[begin + 3] not in (_INTEL, _DEC, _MIPS):
        raise InputError(
            f"{path}: this is not a C3D file, or its header is damaged; copy or export it again."
        )
    if raw[begin + 3] == _MIPS:
        raise InputError(
            f"{path}: its numbers are in the MIPS format, which ezc3d does not read; convert the file to the Intel format."
        )
    try:
        parameters = list(_read_parameters(raw, begin + 4))
    except (IndexError, struct.error):
        raise InputError(
            f"{path}: the file is cut short or damaged within its parameters; copy it again."
        ) from None
    analog = {-one.number for one in parameters if one.number < 0 and one.name == "ANALOG"}
    if any(one.name == "OFFSET" and one.number in analog and one.size == _FLOAT for one in parameters):
        raise InputError(
            f"{path}: its parameter ANALOG:OFFSET has real numbers where the format has integers, and ezc3d does not read such files. The markers are "
            "intact: export them without analogue channels, or as .trc."
        )
    first, last = struct.unpack_from("<HH", raw, 6)
    return first, max(last - first + 1, 0)


class _Parameter(NamedTuple):
    name: str
    #: number of its group; that of a group itself is negative
    number: int
    #: type and size of its values, 0 for a group
    size: int


def _read_parameters(raw: bytes, at: int) -> Iterator[_Parameter]:
    """Follow the chain of parameters to its end, for which ezc3d searches forever in a damaged file.

    **Raises:** `IndexError` or `struct.error` if the chain leads out of the file, or values out of their
    parameter.
    """
    while raw[at]:
        length, number = struct.unpack_from("bb", raw, at)
        link = at + 2 + abs(length)
        (step,) = struct.unpack_from("<H", raw, link)
        end, size = link + 2, 0
        if number > 0:
            size, rank = struct.unpack_from("bB", raw, end)
            end += 2 + rank + abs(size) * math.prod(raw[end + 2 : end + 2 + rank])
            if size not in (-1, 1, 2, _FLOAT) or rank > 7:
                raise IndexError
        # the values are followed by a description with its length
        if end + 1 + raw[end] > (link + step if step else len(raw)):
            raise IndexError
        yield _Parameter(raw[at + 2 : link].decode("latin-1").strip().upper(), number, size)
        if step == 0:
            return
        at = link + step


class DataLayout(NamedTuple):
    """The layout of the numbers of the frames, according to the header."""

    #: byte at which they begin
    begin: int
    points: int
    #: analogue values that follow the points of each frame
    analog_values: int
    #: metres or other units for each integer; not above zero if the numbers are floats
    scale: float
    #: whether floats are those of DEC processors
    is_dec: bool

    @property
    def frame_size(self) -> int:
        """Size of a frame in bytes."""
        return (4 * self.points + self.analog_values) * (2 if self.scale > 0 else 4)

    def file_size(self, frames: int) -> int:
        """Compute the size in bytes of a file with a number of frames."""
        return self.begin + frames * self.frame_size


def read_layout(path: Path) -> DataLayout:
    """Read the layout of the frames from the header."""
    with path.open("rb") as file:
        head = file.read(512)
        file.seek(512 * (head[0] - 1) + 3)
        is_dec = file.read(1)[0] == _DEC
    points, values = struct.unpack_from("<HH", head, 2)
    (block,) = struct.unpack_from("<H", head, 16)
    return DataLayout(512 * (block - 1), points, values, float(_parse_floats(head, 12, 1, is_dec)[0]), is_dec)


def _parse_floats(raw: bytes, begin: int, count: int, is_dec: bool) -> Float[np.ndarray, "N"]:
    """Parse floats of Intel or DEC processors; those of DEC are a quarter, with the halves exchanged."""
    if not is_dec:
        return np.frombuffer(raw, "<f4", count, begin)
    halves = np.frombuffer(raw, "<u2", 2 * count, begin).reshape(-1, 2)[:, ::-1]
    return np.ascontiguousarray(halves).view("<f4").ravel() / 4


def read_points(
    path: Path, layout: DataLayout, frames: int
) -> tuple[Float[np.ndarray, "3 M F"], Float[np.ndarray, "M F"]]:
    """Read the points and their residuals by the layout of the header."""
    raw = path.read_bytes()
    count = frames * (4 * layout.points + layout.analog_values)
    if layout.scale > 0:
        values = layout.scale * np.frombuffer(raw, "<i2", count, layout.begin).astype(float)
    else:
        values = _parse_floats(raw, layout.begin, count, layout.is_dec).astype(float)
    table = values.reshape(frames, -1)[:, : 4 * layout.points].reshape(frames, layout.points, 4)
    return np.transpose(table[..., :3], (2, 1, 0)), table[..., 3].T
