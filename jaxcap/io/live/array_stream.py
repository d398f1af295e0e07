"""Frames as a stream of `.npy` arrays, such as a pipe between two programs.

A stream is a sequence of arrays, each as `numpy.save` writes it, without a separator:

- an array without axes, of floating-point numbers: the time of the next frame, seconds;
- `(H, W)` or `(C, H, W)`: the depth images of one camera or of C cameras; whole numbers in units of the depth scale,
  others in metres;
- `(N, 3)` or `(N, 6)`, floating point: a cloud, metres, in the second form with normals.

Nothing is unpickled. The reader needs no length in advance, and memory is limited to one frame.
"""

import math
import threading
import time
from collections.abc import Iterator
from typing import Any

import numpy as np

from ...arguments import checked
from ...errors import InputError
from ...geometry.camera import MAX_PIXELS, MIN_SIDE_PIXELS
from ...observe.clouds import Scan
from ..archives.archive import ArrayHeader, parse_array_header
from ..depth.images import depths_in_metres
from ..depth.sequence import DepthFrame
from ..meshes.clouds import NO_FACES
from .arrivals import Arrival

#: largest number of elements of one array
MAX_ELEMENTS = 4 * MAX_PIXELS


def write_array(file: Any, array: np.ndarray | float) -> None:
    """Write one array of a stream, and pass it on at once."""
    np.lib.format.write_array(file, np.asarray(array), allow_pickle=False)
    file.flush()


@checked
def read_array_stream(
    file: Any,
    name: str = "the stream",
    depth_scale: float | int = 1000.0,
    stop: threading.Event | None = None,
) -> Iterator[Arrival]:
    """Read the frames of a stream of arrays, until its end or until `stop`.

    **Arguments:** `file`, open for reading bytes, such as `sys.stdin.buffer`; `name` for messages; `depth_scale`, the number of the units of whole numbers in a metre. Frames without a
    time have that of their arrival.

    **Raises:** `InputError`, when its turn comes, for an array that is no frame, or a stream that ends within an array.
    """
    return _read(file, name, float(depth_scale), threading.Event() if stop is None else stop)


def _read(file: Any, name: str, depth_scale: float, stop: threading.Event) -> Iterator[Arrival]:
    stamp, number, begin = None, 0, time.monotonic()
    while not stop.is_set():
        where = f"{name}[{number}]"
        array = _read_array(file, where)
        if array is None:
            return
        now = time.monotonic()
        if array.ndim == 0:
            stamp = _time(array, where)
            continue
        frame = _frame(array, where, depth_scale)
        yield Arrival(where, now - begin if stamp is None else stamp, now, lambda frame=frame: frame)
        stamp, number = None, number + 1


def _read_array(file: Any, where: str) -> np.ndarray | None:
    """Read one array; None at the end of the stream. Raises `InputError`."""
    first = file.read(1)
    if not first:
        return None
    head = _Pushed(first, file)
    try:
        header = parse_array_header(head)
    except ValueError:
        problem = (
            "the stream ends within this frame; the frames before it are complete."
            if head.has_ended
            else "this is not an array as numpy.save writes it; write whole arrays, one after the other."
        )
        raise InputError(f"{where}: {problem}") from None
    _check_header(header, where)
    size = math.prod(header.shape) * header.dtype.itemsize
    data = bytearray(size)
    view, at = memoryview(data), 0
    while at < size:
        count = file.readinto(view[at:])
        if not count:
            raise InputError(
                f"{where}: the stream ends within this frame; the frames before it are complete."
            )
        at += count
    array = np.frombuffer(data, header.dtype).reshape(
        header.shape, order="F" if header.fortran_order else "C"
    )
    return array.astype(header.dtype.newbyteorder("="), copy=False)


def _check_header(header: ArrayHeader, where: str) -> None:
    """Check that an array is of numbers and not too large, before memory is allocated. Raises `InputError`."""
    if header.dtype.hasobject or header.dtype.kind not in "iuf" or header.dtype.itemsize > 8:
        raise InputError(
            f"{where}: the array has the type {header.dtype}; expected whole or floating-point numbers."
        )
    if math.prod(header.shape) > MAX_ELEMENTS:
        raise InputError(
            f"{where}: the array has the shape {header.shape}; expected at most {MAX_ELEMENTS} numbers in a frame."
        )


def _time(array: np.ndarray, where: str) -> float:
    seconds = float(array)
    if not math.isfinite(seconds):
        raise InputError(f"{where}: the time of this frame is {seconds}; expected seconds.")
    return seconds


def _frame(array: np.ndarray, where: str, depth_scale: float) -> DepthFrame | Scan:
    """Convert an array to depth images or to a cloud. Raises `InputError`."""
    if array.ndim == 2 and array.shape[1] in (3, 6) and array.dtype.kind == "f":
        normals = array[:, 3:].astype(float) if array.shape[1] == 6 else None
        return Scan(where, array[:, :3].astype(float), normals, NO_FACES)
    if array.ndim in (2, 3) and min(array.shape[-2:]) >= MIN_SIDE_PIXELS:
        depths = depths_in_metres(array[None] if array.ndim == 2 else array, depth_scale)
        return DepthFrame(where, tuple(depths), (None,) * len(depths))
    raise InputError(
        f"{where}: the array has the shape {array.shape} and the type {array.dtype}; expected depth images (H, W) or "
        "(C, H, W), or floating-point points (N, 3) or (N, 6)."
    )


class _Pushed:
    """A stream with its first byte put back."""

    def __init__(self, first: bytes, file: Any):
        self._first, self._file = first, file
        self.has_ended = False

    def read(self, size: int) -> bytes:
        data, self._first = self._first[:size], self._first[size:]
        if size > len(data):
            data += self._file.read(size - len(data))
        self.has_ended = len(data) < size
        return data
