"""The arrays of `.pkl` files of body models: a pickle's opcodes are interpreted here, and it is never unpickled.

The models of SMPL's family are distributed as pickles of a dict of arrays. `PickleMachine` runs the opcodes on inert records. The
records of the requested entries are then converted to arrays, by the layouts that NumPy, SciPy and chumpy write.
"""

import math
import os
import re
from collections.abc import Collection
from pathlib import Path
from typing import Any

import numpy as np
import scipy.sparse as sparse

from ...errors import InputError
from ..system.reader_errors import reader_of
from ..text import shortened
from .archive import MAX_ARRAYS, MAX_EMPTY_AXIS, MIN_MEMORY_LIMIT
from .pickle_machine import REMEDY, PickleMachine, describe_value, entry_name, role_of

#: an array, a number or text
Value = np.ndarray | float | int | str | None
Values = dict[str, Value]

#: limit of the memory of all arrays, in multiples of the file size, above `MIN_MEMORY_LIMIT`
MAX_GROWTH = 8
#: largest number of axes of an array, and of nested chumpy wrappers
MAX_AXES, MAX_WRAPPERS = 16, 8


def read_pickled_arrays(path: str | os.PathLike[str], names: Collection[str] | None = None) -> Values:
    """Read the arrays, numbers and strings of the dict in a `.pkl` file, all or those with `names`.

    Sparse matrices become dense, chumpy's wrappers the arrays in them, and nested lists of numbers arrays. Other
    lists and dicts are left out if there are no `names`. Arrays are in native byte order and in C order.

    **Raises:** `InputError` if the file is no pickle of a dict, is incomplete or damaged, holds code, which is any
    function, class or opcode that arrays do not need, or needs too much memory for its size; or if a requested
    entry cannot be converted.
    """
    return _read(Path(path), names)


@reader_of("a pickle of arrays")
def _read(path: Path, names: Collection[str] | None) -> Values:
    data = path.read_bytes()
    content = PickleMachine(data).run()
    if role_of(content) == "container":  # of Python 2, as a list of pairs
        content = {entry_name(key): value for key, value in content.arguments[0]}
    if not isinstance(content, dict):
        raise InputError(f"the pickle holds {describe_value(content)} and no dict of arrays; {REMEDY}")
    if len(content) > MAX_ARRAYS:
        raise InputError(f"the pickle has {len(content)} entries; expected at most {MAX_ARRAYS}.")
    converter = _Converter(max(MIN_MEMORY_LIMIT, MAX_GROWTH * len(data)))
    found: Values = {}
    for name in [each for each in content if each and (names is None or each in names)]:
        value = content[name]
        try:
            found[name] = converter.convert(value)
        except _EntryError as error:
            container = isinstance(value, list | tuple | dict) or role_of(value) == "container"
            if names is not None or not container:
                raise InputError(f"the entry '{shortened(name)}' {error}; {REMEDY}") from None
    return found


class _EntryError(Exception):
    """The fault of an entry: the middle of a sentence that begins with its name and ends with the remedy."""


def _check(*conditions: Any) -> None:
    """Check the numbers and lengths of an entry. Raises `_EntryError`."""
    if not all(np.all(each) for each in conditions):
        raise _EntryError("has indices, lengths or letters that do not fit together")


def _shape(value: Any) -> tuple[int, ...]:
    """Check the shape of an array. Raises `_EntryError`."""
    if isinstance(value, list | tuple) and len(value) <= MAX_AXES:
        shape = tuple(int(length) if isinstance(length, int) else -1 for length in value)
        if all(0 <= length <= max(MAX_EMPTY_AXIS, math.prod(shape)) for length in shape):
            return shape
    raise _EntryError("has no valid shape")


def _dtype(value: Any) -> np.dtype:
    """Convert the type of an array. Raises `_EntryError` for other types than numbers and text."""
    match role_of(value) == "dtype" and (value.arguments, value.state):
        case ((str(code), *_), state):
            kind = code.lstrip("<>|=")
            order = state[1] if isinstance(state, tuple) and len(state) > 1 else code[:1]
            if kind.startswith("O"):
                raise _EntryError("has the type object: it holds pickled objects, which are never read")
            if re.fullmatch(r"[iu][1248]|b1|f[248]|[SU][1-9]\d{0,5}", kind):
                return np.dtype(kind).newbyteorder(order if order in ("<", ">") else "=")
            raise _EntryError(f"has the type {shortened(code)}, which is not read")
    raise _EntryError("has no valid type")


class _Converter:
    """The conversion of the values of a pickle to arrays, within a limit of memory in bytes."""

    def __init__(self, memory: int):
        self.memory = memory

    def spend(self, size: int) -> None:
        """Count the memory of a value before it is made. Raises `_EntryError` beyond the limit."""
        self.memory -= size + 64
        if self.memory < 0:
            raise _EntryError("needs too much memory for a file of this size; it is damaged or malicious")

    def convert(self, value: Any) -> Value:
        """Convert an entry. Raises `_EntryError`."""
        if value is None or isinstance(value, float | str) or (isinstance(value, int) and abs(value) < 2**64):
            return value
        if role_of(value) == "bytes" or isinstance(value, bytes | bytearray):
            return self.read_bytes(value).decode("latin-1")
        array = self.array(value)
        return array.item() if role_of(value) == "scalar" else array

    def convert_list(self, value: Any) -> np.ndarray | None:
        """Convert a number or nested lists of numbers, `None` for others. Raises `_EntryError` beyond the limit."""
        shape: list[int] = []
        level = [value]
        while level and all(isinstance(each, list | tuple) for each in level):
            if len(shape) == MAX_AXES or any(len(each) != len(level[0]) for each in level):
                return None
            shape.append(len(level[0]))
            self.spend(16 * shape[-1] * len(level))
            level = [item for each in level for item in each]
        level = [self.convert(each) if role_of(each) == "scalar" else each for each in level]
        if not {type(each) for each in level} <= {bool, int, float}:
            return None
        array = np.array(level)  # of objects if a number is too large
        return array.reshape(shape) if array.dtype.kind in "biuf" else None

    def array(self, value: Any, depth: int = 0) -> np.ndarray:
        """Convert an array, a sparse matrix, a wrapper of chumpy, or numbers. Raises `_EntryError`."""
        if role_of(value) != "scalar" and (numbers := self.convert_list(value)) is not None:
            return numbers
        match depth <= MAX_WRAPPERS and role_of(value) and (value.role, value.arguments, value.state):
            case ("array", _, (*_, shape, dtype, by_columns, data)):
                return self.elements(dtype, data, _shape(shape), "F" if by_columns else "C")
            case ("scalar", (dtype, data), _):
                return self.elements(dtype, data, ())
            case ("buffer", (data, dtype, shape, "C" | "F" as order, *_), _):
                return self.elements(dtype, data, _shape(shape), order)
            case ("buffer", (data, dtype, shape, "K", axes), _):
                array = self.elements(dtype, data, _shape(shape))
                _check(sorted(_shape(axes)) == list(range(array.ndim)))
                return np.ascontiguousarray(array.transpose(axes))
            case ("sparse", _, {"_shape": shape, "data": data, **parts}):
                return self.dense(value.name, _shape(shape), self.array(data, MAX_WRAPPERS), parts)
            case ("wrapper", _, {"x": content}):
                return self.array(content, depth + 1)
            case ("selection", _, {"a": content, "idxs": indices, **parts}):
                array, chosen = self.array(content, depth + 1).ravel(), self.indices(indices)
                shape = _shape(parts.get("preferred_shape", chosen.shape))
                _check(chosen >= -array.size, chosen < array.size, math.prod(shape) == chosen.size)
                self.spend(chosen.size * array.itemsize)
                return array[chosen].reshape(shape)
        raise _EntryError(f"is {describe_value(value)}, which is not an array")

    def elements(self, dtype: Any, data: Any, shape: tuple[int, ...], order: Any = "C") -> np.ndarray:
        """Convert the bytes of an array. Raises `_EntryError`."""
        kind, raw = _dtype(dtype), self.read_bytes(data)
        if math.prod(shape) * kind.itemsize != len(raw):
            raise _EntryError(f"has the shape {shape} and the type {kind}, but {len(raw)} bytes of data")
        self.spend(len(raw) * (5 if kind.kind == "S" else 1))
        array = (np.frombuffer(raw, kind) if raw else np.zeros(0, kind)).reshape(shape, order=order)
        if kind.kind == "S":
            return np.ascontiguousarray(np.strings.decode(array, "latin-1"))
        array = np.array(array, kind.newbyteorder("="), order="C")
        if kind.kind == "U":
            letters = np.frombuffer(array.tobytes(), np.uint32)
            _check(letters <= 0x10FFFF, (letters < 0xD800) | (letters >= 0xE000))
        return array

    def read_bytes(self, value: Any) -> bytes:
        """Return bytes, which may be Latin-1 text or the record of its encoding. Raises `_EntryError`."""
        arguments = value.arguments if role_of(value) == "bytes" else (value,)
        match arguments[:1]:
            case ():
                return b""
            case (bytes() | bytearray() | str() as data,):
                self.spend(len(data))
                return data.encode("latin-1", "backslashreplace") if isinstance(data, str) else bytes(data)
        raise _EntryError("has no bytes of data")

    def indices(self, value: Any) -> np.ndarray:
        """Convert a list of indices. Raises `_EntryError`."""
        array = self.array(value, MAX_WRAPPERS)
        _check(array.ndim == 1 and (array.dtype.kind in "iu" or not array.size))
        return array.astype(np.int64)

    def dense(self, name: str, shape: tuple[int, ...], numbers: np.ndarray, parts: dict) -> np.ndarray:
        """Convert a sparse matrix to a dense array. Raises `_EntryError`."""
        _check(len(shape) == 2 and numbers.dtype.kind in "biuf")
        self.spend(math.prod(shape) * numbers.itemsize)
        try:
            if "indptr" in parts:
                make = sparse.csc_array if ".csc_" in name else sparse.csr_array
                minor, starts = self.indices(parts.get("indices")), self.indices(parts["indptr"])
                matrix = make((numbers, minor, starts), shape)
                matrix.check_format(full_check=True)
            else:
                places = parts.get("coords", (parts.get("row"), parts.get("col")))
                matrix = sparse.coo_array((numbers, tuple(map(self.indices, places))), shape)
            return matrix.toarray(order="C")
        except (TypeError, ValueError):
            raise _EntryError("is a sparse matrix whose indices do not fit its shape") from None
