"""The arrays of `.npz` files: checked before memory is allocated, and never pickled."""

import contextlib
import math
import os
import zipfile
from collections.abc import Callable, Collection, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ...errors import InputError

#: limits of all arrays: bytes, at 8 a number as all become double precision, or multiples of the file size
MIN_MEMORY_LIMIT, MAX_EXPANSION = 2**27, 64
#: largest number of arrays in one file
MAX_ARRAYS = 4096
#: largest length of an axis of an array without elements
MAX_EMPTY_AXIS = 1_000_000
_METHODS = {zipfile.ZIP_STORED: "stored", zipfile.ZIP_DEFLATED: "deflated"}
_CHUNK_SIZE = 2**20


class ArrayHeader(NamedTuple):
    """The header of an array."""

    shape: tuple[int, ...]
    fortran_order: bool
    dtype: np.dtype


def array_names(path: str | Path) -> list[str]:
    """Return the names of the arrays of an `.npz` file. Raises `InputError` if it is not one."""
    with open_archive(path) as archive:
        return list(archive.members)


def array_lengths(path: str | Path, names: Collection[str]) -> dict[str, int]:
    """Return the lengths of the first axis of the `names` arrays that an `.npz` file has, without their elements.

    Raises `InputError` if it is not an `.npz` file, or one of these arrays is damaged.
    """
    with open_archive(path) as archive:
        heads = {
            name: _read_array_header(archive.file, info, f"{path}: the array '{name}'")
            for name, info in archive.members.items()
            if name in names
        }
    return {name: head.shape[0] for name, head in heads.items() if head.shape}


def read_format_name(path: str | Path) -> str:
    """Return the format name of an `.npz` file, empty if it has none.

    Raises `InputError` if it is not an `.npz` file.
    """
    return str(load_arrays(path, lambda name: name == "format").get("format", ""))


def load_arrays(path: str | Path, select: Callable[[str], bool] = lambda name: True) -> dict[str, np.ndarray]:
    """Read the arrays of any `.npz` file with `select` names, all by default.

    **Raises:** `InputError` if the file is not one, and as `Archive.load` does.
    """
    with open_archive(path) as archive:
        return archive.load(select)


class Archive(NamedTuple):
    """An open `.npz` file; its arrays are read on demand."""

    path: str | Path
    file: zipfile.ZipFile
    #: by array name
    members: dict[str, zipfile.ZipInfo]

    def load(self, select: Callable[[str], bool]) -> dict[str, np.ndarray]:
        """Read the arrays with `select` names.

        Their headers are checked before the first array is inflated; the other arrays are not read.

        **Raises:** `InputError` if the file is damaged, if a wanted array holds pickled objects or other data
        than numbers and text, or if the arrays inflate beyond the limit for the size of the file.
        """
        path, file = self.path, self.file
        chosen = {name: info for name, info in self.members.items() if select(name)}
        heads = {
            name: _read_array_header(file, info, f"{path}: the array '{name}'")
            for name, info in chosen.items()
        }
        taken = sum(math.prod(head.shape) * max(head.dtype.itemsize, 8) for head in heads.values())
        size = os.path.getsize(path)
        if taken > max(MIN_MEMORY_LIMIT, MAX_EXPANSION * size):
            raise InputError(
                f"{path}: the arrays need {taken / 1e6:.0f} MB of memory, but the file has only {size / 1e6:.2g} MB; it is "
                "damaged or malicious, so get it again."
            )
        return {
            name: _numbers(file, info, heads[name], f"{path}: the array '{name}'")
            for name, info in chosen.items()
        }


@contextlib.contextmanager
def open_archive(path: str | Path) -> Iterator[Archive]:
    """Open an `.npz` file; every exception of the library that reads it becomes an `InputError`.

    **Raises:** `InputError` if the file is not one or cannot be read.
    """
    try:
        with open(path, "rb") as raw:
            start = raw.read(6)
            if start == b"\x93NUMPY":
                raise InputError(
                    f"{path}: this is a single array, not an .npz file of named arrays; write it with numpy.savez."
                )
            if not start.startswith(b"PK"):
                raise InputError(f"{path}: this is not an .npz file; give an .npz file.")
            with zipfile.ZipFile(raw) as file:
                yield Archive(path, file, _members(file, path))
    except InputError:
        raise
    except FileNotFoundError:
        raise InputError(f"{path}: there is no such file; check the path.") from None
    except (IsADirectoryError, PermissionError) as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); give a readable file.") from None
    except Exception as error:  # any error of zipfile and zlib on a damaged file
        raise InputError(
            f"{path}: this .npz file is incomplete or damaged ({type(error).__name__}); copy or write it again."
        ) from None


def _members(file: zipfile.ZipFile, path: str | Path) -> dict[str, zipfile.ZipInfo]:
    """Return the members of an archive by array name.

    Raises `InputError` for too many, or for duplicate names.
    """
    found: dict[str, zipfile.ZipInfo] = {}
    members = file.infolist()
    if len(members) > MAX_ARRAYS:
        raise InputError(f"{path}: the file contains {len(members)} arrays; expected at most {MAX_ARRAYS}.")
    for info in members:
        name = info.filename.removesuffix(".npy")
        if name in found:
            raise InputError(f"{path}: the file contains two arrays named '{name}'; write the file again.")
        found[name] = info
    return found


def _read_array_header(file: zipfile.ZipFile, info: zipfile.ZipInfo, where: str) -> ArrayHeader:
    """Read the header of an array and check it against the archive. Raises `InputError`."""
    if info.flag_bits & 1:
        raise InputError(f"{where} is encrypted; write the file without a password.")
    if info.compress_type not in _METHODS:
        raise InputError(
            f"{where} has the compression method {info.compress_type}; write it with numpy.savez_compressed."
        )
    with file.open(info) as stream:
        try:
            head = parse_array_header(stream)
        except ValueError:
            raise InputError(f"{where} is not a NumPy array; write the file with numpy.savez.") from None
        begins = stream.tell()
    if head.dtype.hasobject:
        raise InputError(f"{where} contains pickled objects, which are never read; write plain arrays.")
    if head.dtype.kind not in "biufUS":
        raise InputError(f"{where} has the type {head.dtype}; write numbers or text.")
    size, there = math.prod(head.shape) * head.dtype.itemsize, info.file_size - begins
    if size != there:
        raise InputError(
            f"{where} has the shape {head.shape} and needs {size} bytes, but the file has {there}; it is damaged."
        )
    if max(head.shape, default=0) > max(MAX_EMPTY_AXIS, size):
        raise InputError(f"{where} has the shape {head.shape} but no elements; it is damaged.")
    return head


def parse_array_header(stream: Any) -> ArrayHeader:
    """Parse the header of an array. Raises `ValueError` if it is invalid."""
    version = np.lib.format.read_magic(stream)
    readers = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}
    if version not in readers:
        raise ValueError(f"version {version}")
    try:
        shape, by_columns, dtype = readers[version](stream)
    except Exception as error:  # a header is an arbitrary Python literal
        raise ValueError("no head") from error
    if not all(isinstance(length, int) and 0 <= length < 2**40 for length in shape) or len(shape) > 16:
        raise ValueError(f"shape {shape}")
    return ArrayHeader(shape, by_columns, dtype)


def _numbers(file: zipfile.ZipFile, info: zipfile.ZipInfo, head: ArrayHeader, where: str) -> np.ndarray:
    """Read the elements of an array in native byte order. Raises `InputError` for invalid text."""
    data = bytearray(math.prod(head.shape) * head.dtype.itemsize)
    with file.open(info) as stream:
        parse_array_header(stream)
        at = 0
        while at < len(data):
            piece = stream.read(_CHUNK_SIZE)
            if not piece:
                raise EOFError
            data[at : at + len(piece)] = piece
            at += len(piece)
    if not data:
        return np.zeros(head.shape, head.dtype.newbyteorder("=") if head.dtype.kind != "S" else "U1")
    values = np.frombuffer(data, head.dtype).reshape(head.shape, order="F" if head.fortran_order else "C")
    if head.dtype.kind == "f" and head.dtype.itemsize > 8:
        return values.astype(float)
    if head.dtype.kind == "S":
        return np.strings.decode(values, "latin-1")
    values = values.astype(head.dtype.newbyteorder("="), copy=False)
    if head.dtype.kind == "U":
        letters = np.frombuffer(values.tobytes(), np.uint32)
        if ((letters > 0x10FFFF) | ((letters >= 0xD800) & (letters < 0xE000))).any():
            raise InputError(f"{where} contains invalid text; the file is damaged.")
    return values
