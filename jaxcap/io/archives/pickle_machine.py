"""The stack machine of pickles, without their functions and classes.

A pickle is a program that may call any function of any module. This machine knows numbers, text, lists, tuples and dicts. A
global is an inert name from a list, and a call of it is a record: nothing is imported and nothing is called.
"""

import codecs
import io
import pickletools
import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from ...errors import InputError
from ..text import shortened

#: largest number of opcodes, and so of values, marks and positions of the memo
MAX_OPCODES = 2_000_000
#: largest number of letters of a name
MAX_LETTERS = 256
REMEDY = "get the model from its authors, or write its arrays with numpy.savez."
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


@dataclass(slots=True, eq=False)
class Symbol:
    """A function or class that a pickle mentions, or with arguments the record of a call of it."""

    name: str
    role: str
    arguments: tuple | None = None
    #: what the pickle sets on the result of the call
    state: Any = None


def role_of(value: Any) -> str:
    """Return the role of the record of a call, empty for other values."""
    return value.role if isinstance(value, Symbol) and value.arguments is not None else ""


def describe_value(value: object) -> str:
    """Describe a value in a message."""
    return f"an object of the type {value.name if isinstance(value, Symbol) else type(value).__name__}"


def entry_name(key: object) -> str:
    """Return the name of an entry, empty if its key is no short text."""
    if not isinstance(key, str | bytes) or len(key) > MAX_LETTERS:
        return ""
    return key if isinstance(key, str) else key.decode("latin-1")


def _read_string(stream: io.BytesIO) -> str:
    """Read a string of Python 2, protocol 0, whose bytes may have any value, which `pickletools` does not allow."""
    line = stream.readline()
    if len(line) < 3 or line[:1] not in (b"'", b'"') or line[-2:] != line[:1] + b"\n":
        raise ValueError
    return codecs.escape_decode(line[1:-2])[0].decode("latin-1")


class PickleMachine:
    """The stack machine of pickles, protocols 0 to 5.

    With `further` globals and their roles, references to data outside the pickle are records too, of the role `persistent`.
    """

    def __init__(self, data: bytes, further: Mapping[str, str] | None = None):
        self.data, self.stream = data, io.BytesIO(data)
        self.known = _GLOBALS | dict(further or {})
        self.refers = further is not None
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
        raise InputError(f"the pickle has more than {MAX_OPCODES} opcodes; {REMEDY}")

    def code(self, what: str) -> InputError:
        """Build the error of a file that holds code."""
        return InputError(f"the file holds code: {what} at byte {self.position}, which is not run; {REMEDY}")

    def push_global(self, module: str, name: str) -> None:
        """Add an inert name to the stack. Raises `InputError` if it is not in the list."""
        text = " ".join((module[:MAX_LETTERS], name[:MAX_LETTERS]))
        role = next((role for pattern, role in self.known.items() if re.fullmatch(pattern, text)), None)
        text = shortened(text.replace(" ", "."))
        if role is None:
            raise self.code(f"the global {text}")
        self.stack.append(Symbol(text, role))

    def push_call(self, function: Any, arguments: Any) -> None:
        """Add the record of a call to the stack. Raises `InputError` if it does not call a global."""
        if isinstance(function, Symbol) and function.role == "instance":
            function, arguments = arguments[0], ()
        if not isinstance(function, Symbol) or function.arguments is not None:
            raise self.code(f"a call of {describe_value(function)}")
        if not isinstance(arguments, tuple):
            raise TypeError
        call = Symbol(function.name, function.role, arguments)
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
                self.stack[-1].update(zip(map(entry_name, items[::2]), items[1::2], strict=True))
            case "GLOBAL":
                self.push_global(*argument.split(" ", 1))
            case "STACK_GLOBAL":
                attribute, module = stack.pop(), stack.pop()
                self.push_global(module, attribute)
            case "REDUCE" | "NEWOBJ":
                arguments, function = stack.pop(), stack.pop()
                self.push_call(function, arguments)
            case "BINPERSID" if self.refers:
                stack.append(Symbol("reference", "persistent", (stack.pop(),)))
            case "BUILD":
                state = stack.pop()
                stack[-1].state = state
            case _:
                raise self.code(f"the opcode {name} {shortened(str(argument or ''))}".rstrip())
