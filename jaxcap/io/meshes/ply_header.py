"""The header of a PLY file: elements, their counts, and the types of their properties."""

from pathlib import Path
from typing import NamedTuple

import numpy as np

from ...errors import InputError
from ..text import parse_int, shortened

#: NumPy types of the numbers, by both of their names
NUMBER_TYPES = {
    **dict(zip(("char", "uchar", "short", "ushort"), ("i1", "u1", "i2", "u2"), strict=True)),
    **dict(zip(("int", "uint", "float", "double"), ("i4", "u4", "f4", "f8"), strict=True)),
    **dict(zip(("int8", "uint8", "int16", "uint16"), ("i1", "u1", "i2", "u2"), strict=True)),
    **dict(zip(("int32", "uint32", "float32", "float64"), ("i4", "u4", "f4", "f8"), strict=True)),
}
_BYTE_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}


class Property(NamedTuple):
    """A number of an element, or, if `length_type` is the type of its length, a list of numbers."""

    name: str
    type: np.dtype
    length_type: np.dtype | None = None


class Element(NamedTuple):
    """An element type with its `count`, such as `vertex` or `face`."""

    name: str
    count: int
    properties: list[Property]

    @property
    def has_lists(self) -> bool:
        return any(one.length_type is not None for one in self.properties)


class Header(NamedTuple):
    """The header's contents; the number of its `lines`, and its `end` in bytes."""

    text: bool
    elements: list[Element]
    lines: int
    end: int

    def count_of(self, name: str) -> int:
        """Count the elements of a name."""
        return sum(element.count for element in self.elements if element.name == name)


def read_header(data: bytes, path: Path) -> Header:
    """Read the header of a file. Raises `InputError` with the line."""
    order, elements, at = None, [], 0
    for number in range(1, data.count(b"\n") + 1):
        end = data.index(b"\n", at) + 1
        words, where = data[at:end].decode("utf-8", "replace").split(), f"{path}:{number}"
        at = end
        match words:
            case ["end_header", *_]:
                if order is None:
                    raise InputError(f"{where}: the header has no line 'format'; write the file again.")
                return Header(order == "", elements, number, end)
            case ["format", name, *_]:
                if name not in _BYTE_ORDERS:
                    raise InputError(
                        f"{where}: '{shortened(name)}' is not a format; expected {', '.join(_BYTE_ORDERS)}."
                    )
                order = _BYTE_ORDERS[name]
            case ["element", name, count]:
                elements.append(Element(name, _count(count, where, name), []))
            case ["property", *rest]:
                if not elements or order is None:
                    raise InputError(
                        f"{where}: a property comes before the format or before any element; move it."
                    )
                elements[-1].properties.append(_property(rest, order, where))
    raise InputError(
        f"{path}: this .ply file is incomplete (its header has no line 'end_header'); write it again."
    )


def _count(word: str, where: str, name: str) -> int:
    count = parse_int(word, where, f"the number of '{shortened(name)}'")
    if count < 0:
        raise InputError(
            f"{where}: the number of '{shortened(name)}' is {count}; expected a number of at least 0."
        )
    return count


def _property(words: list[str], order: str, where: str) -> Property:
    types, name = words[:-1], (words or [""])[-1]
    strange = next((word for word in types if word not in NUMBER_TYPES and word != "list"), None)
    if strange is not None:
        raise InputError(
            f"{where}: '{shortened(strange)}' is not a number type; expected {', '.join(NUMBER_TYPES)}."
        )
    found = [np.dtype(order + NUMBER_TYPES[word]) for word in types if word != "list"]
    if types[:1] == ["list"] and len(types) == len(found) + 1 == 3 and found[0].kind in "iu":
        return Property(name, found[1], found[0])
    if len(types) == len(found) == 1:
        return Property(name, found[0])
    raise InputError(
        f"{where}: '{shortened(' '.join(words))}' is not a property; expected a type and a name, or 'list', two types and a name."
    )
