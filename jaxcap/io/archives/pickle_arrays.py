"""The arrays of `.pkl` files of body models: a pickle's opcodes are interpreted here, and it is never unpickled.

The models of SMPL's family are distributed as pickles of a dict of arrays. A pickle is a program that may call any
function of any module. Here it runs on a stack machine that knows numbers, text, lists, tuples and dicts. A global
is an inert name from a list, and a call of it is a record: nothing is imported and nothing is called. The records
of the requested entries are then converted to arrays, by the layouts that NumPy, SciPy and chumpy write.
"""

import codecs
import io
import math
import os
import pickletools
import re
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import scipy.sparse as sparse

from ...errors import InputError
from ..system.reader_errors import reader_of
from ..text import shortened
from .archive import MAX_ARRAYS, MAX_EMPTY_AXIS, MIN_MEMORY_LIMIT

#: an array, a number or text
Value = np.ndarray | float | int | str | None
Values = dict[str, Value]

#: limit of the memory of all arrays, in multiples of the file size, above `MIN_MEMORY_LIMIT`
MAX_GROWTH = 8
#: largest number of opcodes, and so of values, marks and positions of the memo
MAX_OPCODES = 2_000_000
#: largest number of axes of an array, of nested chumpy wrappers, and of letters of a name
MAX_AXES, MAX_WRAPPERS, MAX_LETTERS = 16, 8, 256
_REMEDY = "get the model from its authors, or write its arrays with numpy.savez."
_OPCODES = {each.code.encode("latin-1"): each for each in pickletools.opcodes}
#: opcodes that push their argument: a number, text or bytes
_LITERALS = frozenset(
    each.name
    for each in pickletools.opcodes
    if each.arg and not each.stack_before and each.stack_after and each.stack_after[0].name != "any"
)
_CONSTANTS = {"NONE": None, "NEWTRUE": True, "NEWFALSE": False, "EMPTY_TUPLE": ()}
#: modules and names that a pickle may mention -> their role
_GLOBALS = {
    r"numpy\._?core\.multiarray _reconstruct": "array",
    r"numpy\._?core\.numeric _frombuffer": "buffer",
    r"numpy\._?core\.multiarray scalar": "scalar",
    r"numpy dtype": "dtype",
    r"numpy (ndarray|matrix)|numpy\.matrixlib\.defmatrix matrix|(__builtin__|builtins) object": "class",
    r"_codecs encode|(__builtin__|builtins) bytes": "bytes",
    r"copy_?reg _reconstructor": "instance",
    r"collections OrderedDict|(__builtin__|builtins) (set|frozenset)": "container",
    r"scipy\.sparse\._?(csc|csr|coo) \1_(matrix|array)": "sparse",
    r"chumpy\.ch Ch": "wrapper",
    r"chumpy\.reordering Select": "selection",
    r"chumpy(\.\w+)? \w+": "expression",
}


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
    content = _Machine(data).run()
    if _role(content) == "container":  # of Python 2, as a list of pairs
        content = {_name(key): value for key, value in content.arguments[0]}
    if not isinstance(content, dict):
        raise InputError(f"the pickle holds {_describe(content)} and no dict of arrays; {_REMEDY}")
    if len(content) > MAX_ARRAYS:
        raise InputError(f"the pickle has {len(content)} entries; expected at most {MAX_ARRAYS}.")
    converter = _Converter(max(MIN_MEMORY_LIMIT, MAX_GROWTH * len(data)))
    found: Values = {}
    for name in [each for each in content if each and (names is None or each in names)]:
        value = content[name]
        try:
            found[name] = converter.convert(value)
        except _EntryError as error:
            container = isinstance(value, list | tuple | dict) or _role(value) == "container"
            if names is not None or not container:
                raise InputError(f"the entry '{shortened(name)}' {error}; {_REMEDY}") from None
    return found


class _EntryError(Exception):
    """The fault of an entry: the middle of a sentence that begins with its name and ends with the remedy."""


@dataclass(slots=True, eq=False)
class _Symbol:
    """A function or class that a pickle mentions, or with arguments the record of a call of it."""

    name: str
    role: str
    arguments: tuple | None = None
    #: what the pickle sets on the result of the call
    state: Any = None


def _role(value: Any) -> str:
    """Return the role of the record of a call, empty for other values."""
    return value.role if isinstance(value, _Symbol) and value.arguments is not None else ""


def _describe(value: object) -> str:
    """Describe a value in a message."""
    return f"an object of the type {value.name if isinstance(value, _Symbol) else type(value).__name__}"


def _name(key: object) -> str:
    """Return the name of an entry, empty if its key is no short text."""
    if not isinstance(key, str | bytes) or len(key) > MAX_LETTERS:
        return ""
    return key if isinstance(key, str) else key.decode("latin-1")


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
    match _role(value) == "dtype" and (value.arguments, value.state):
        case ((str(code), *_), state):
            kind = code.lstrip("<>|=")
            order = state[1] if isinstance(state, tuple) and len(state) > 1 else code[:1]
            if kind.startswith("O"):
                raise _EntryError("has the type object: it holds pickled objects, which are never read")
            if re.fullmatch(r"[iu][1248]|b1|f[248]|[SU][1-9]\d{0,5}", kind):
                return np.dtype(kind).newbyteorder(order if order in ("<", ">") else "=")
            raise _EntryError(f"has the type {shortened(code)}, which is not read")
    raise _EntryError("has no valid type")


def _read_string(stream: io.BytesIO) -> str:
    """Read a string of Python 2, protocol 0, whose bytes may have any value, which `pickletools` does not allow."""
    line = stream.readline()
    if len(line) < 3 or line[:1] not in (b"'", b'"') or line[-2:] != line[:1] + b"\n":
        raise ValueError
    return codecs.escape_decode(line[1:-2])[0].decode("latin-1")


class _Machine:
    """The stack machine of pickles, protocols 0 to 5."""

    def __init__(self, data: bytes):
        self.data, self.stream = data, io.BytesIO(data)
        self.stack: list[Any] = []
        #: the stacks below the marks
        self.marks: list[list[Any]] = []
        self.memo: dict[int, Any] = {}
        #: of the opcode, in bytes
        self.position = 0

    def run(self) -> Any:
        """Run the opcodes and return the result. Raises `InputError`."""
        if self.data[:2] == b"PK":
            raise InputError("this is a zip archive, such as an .npz file, and no pickle; rename it.")
        for _ in range(MAX_OPCODES):
            self.position = self.stream.tell()
            try:
                opcode = _OPCODES[self.stream.read(1)]
                read = _read_string if opcode.name == "STRING" else opcode.arg and opcode.arg.reader
                argument = read(self.stream) if read else None
                if opcode.name == "STOP":
                    return self.stack.pop()
                self.step(opcode.name, argument)
            except InputError:
                raise
            except Exception:  # any error of pickletools, and of operations on unsuitable values
                if self.position == 0:
                    raise InputError("this is not a pickle; give the .pkl file of a body model.") from None
                fault = "incomplete" if self.stream.tell() == len(self.data) else "damaged"
                raise InputError(f"the pickle is {fault} at byte {self.position}; get it again.") from None
        raise InputError(f"the pickle has more than {MAX_OPCODES} opcodes; {_REMEDY}")

    def code(self, what: str) -> InputError:
        """Build the error of a file that holds code."""
        return InputError(f"the file holds code: {what} at byte {self.position}, which is not run; {_REMEDY}")

    def push_global(self, module: str, name: str) -> None:
        """Add an inert name to the stack. Raises `InputError` if it is not in the list."""
        text = " ".join((module[:MAX_LETTERS], name[:MAX_LETTERS]))
        role = next((role for pattern, role in _GLOBALS.items() if re.fullmatch(pattern, text)), None)
        text = shortened(text.replace(" ", "."))
        if role is None:
            raise self.code(f"the global {text}")
        self.stack.append(_Symbol(text, role))

    def push_call(self, function: Any, arguments: Any) -> None:
        """Add the record of a call to the stack. Raises `InputError` if it does not call a global."""
        if isinstance(function, _Symbol) and function.role == "instance":
            function, arguments = arguments[0], ()
        if not isinstance(function, _Symbol) or function.arguments is not None:
            raise self.code(f"a call of {_describe(function)}")
        if not isinstance(arguments, tuple):
            raise TypeError
        call = _Symbol(function.name, function.role, arguments)
        self.stack.append({} if function.role == "container" and not arguments else call)

    def pop_mark(self) -> list[Any]:
        """Take the values above the topmost mark."""
        items, self.stack = self.stack, self.marks.pop()
        return items

    def step(self, name: str, argument: Any) -> None:
        """Run one opcode. Raises `InputError` for code, and any other error if the values do not suit it."""
        stack = self.stack
        match name:
            case _ if name in _LITERALS:
                stack.append(argument)
            case _ if name in _CONSTANTS:
                stack.append(_CONSTANTS[name])
            case "EMPTY_LIST" | "EMPTY_SET" | "EMPTY_DICT":
                stack.append({} if name == "EMPTY_DICT" else [])
            case "PROTO" | "FRAME":
                pass
            case "GET" | "BINGET" | "LONG_BINGET":
                stack.append(self.memo[argument])
            case "PUT" | "BINPUT" | "LONG_BINPUT" | "MEMOIZE":
                place = len(self.memo) if name == "MEMOIZE" else argument
                if not 0 <= place < MAX_OPCODES:
                    raise IndexError
                self.memo[place] = stack[-1]
            case "MARK":
                self.marks.append(stack)
                self.stack = []
            case "POP" if stack:
                stack.pop()
            case "POP" | "POP_MARK":
                self.pop_mark()
            case "DUP":
                stack.append(stack[-1])
            case "TUPLE1" | "TUPLE2" | "TUPLE3":
                items = [stack.pop() for _ in range(int(name[-1]))]
                stack.append(tuple(reversed(items)))
            case "TUPLE" | "LIST" | "FROZENSET":
                items = self.pop_mark()
                self.stack.append(tuple(items) if name == "TUPLE" else items)
            case "APPEND" | "APPENDS" | "ADDITEMS":
                items = [stack.pop()] if name == "APPEND" else self.pop_mark()
                self.stack[-1].extend(items)
            case "DICT" | "SETITEM" | "SETITEMS":
                items = [stack.pop(), stack.pop()][::-1] if name == "SETITEM" else self.pop_mark()
                if name == "DICT":
                    self.stack.append({})
                self.stack[-1].update(zip(map(_name, items[::2]), items[1::2], strict=True))
            case "GLOBAL":
                self.push_global(*argument.split(" ", 1))
            case "STACK_GLOBAL":
                attribute, module = stack.pop(), stack.pop()
                self.push_global(module, attribute)
            case "REDUCE" | "NEWOBJ":
                arguments, function = stack.pop(), stack.pop()
                self.push_call(function, arguments)
            case "BUILD":
                state = stack.pop()
                stack[-1].state = state
            case _:
                raise self.code(f"the opcode {name} {shortened(str(argument or ''))}".rstrip())


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
        if _role(value) == "bytes" or isinstance(value, bytes | bytearray):
            return self.read_bytes(value).decode("latin-1")
        array = self.array(value)
        return array.item() if _role(value) == "scalar" else array

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
        level = [self.convert(each) if _role(each) == "scalar" else each for each in level]
        if not {type(each) for each in level} <= {bool, int, float}:
            return None
        array = np.array(level)  # of objects if a number is too large
        return array.reshape(shape) if array.dtype.kind in "biuf" else None

    def array(self, value: Any, depth: int = 0) -> np.ndarray:
        """Convert an array, a sparse matrix, a wrapper of chumpy, or numbers. Raises `_EntryError`."""
        if _role(value) != "scalar" and (numbers := self.convert_list(value)) is not None:
            return numbers
        match depth <= MAX_WRAPPERS and _role(value) and (value.role, value.arguments, value.state):
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
        raise _EntryError(f"is {_describe(value)}, which is not an array")

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
        arguments = value.arguments if _role(value) == "bytes" else (value,)
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
