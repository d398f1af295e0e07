"""Consistency of a PLY file with its header, checked before a library that does not check reads it."""

from pathlib import Path

import numpy as np
from jaxtyping import Float

from ...errors import InputError
from ..text import parse_int, shortened
from .ply_header import Element, Header, Property, read_header

#: names of the list of vertices of a face
_VERTEX_LIST_NAMES = ("vertex_indices", "vertex_index")


def check_ply(path: Path) -> None:
    """Check the data of a PLY file against its header.

    All elements must be present, numbers must fit their types, and faces must refer to existing vertices.
    Raises `InputError`, with the line in a text file.
    """
    data = path.read_bytes()
    header = read_header(data, path)
    if header.text:
        _check_text(data, header, path)
    else:
        _check_binary(data, header, path)


def _check_text(data: bytes, header: Header, path: Path) -> None:
    lines = data[header.end :].decode("utf-8", "replace").splitlines()
    while lines and not lines[-1].strip():
        lines.pop()
    begin = 0
    for element in header.elements:
        rows = lines[begin : begin + element.count]
        if len(rows) < element.count:
            raise _truncated_error(f"{path}:{header.lines + len(lines)}", element, len(rows))
        _check_rows(rows, element, header, path, header.lines + begin + 1)
        begin += element.count


def _check_rows(rows: list[str], element: Element, header: Header, path: Path, first: int) -> None:
    """Check the rows of an element; `first` is the line number of the first row."""
    words: list[list[str]] = [[] for _ in element.properties]
    lines: list[list[int]] = [[] for _ in element.properties]
    for number, row in enumerate(rows, first):
        left, at = row.split(), 0
        for column, one in enumerate(element.properties):
            count = 1
            if one.length_type is not None and at < len(left):
                count = parse_int(left[at], f"{path}:{number}", f"the length of '{shortened(one.name)}'")
                at += 1
            if not 0 <= count <= len(left) - at:
                raise InputError(
                    f"{path}:{number}: this '{shortened(element.name)}' declares {count} numbers of '{shortened(one.name)}' and "
                    f"has {len(left) - at}; write all of them."
                )
            words[column] += left[at : at + count]
            lines[column] += [number] * count
            at += count
    for column, one in enumerate(element.properties):
        vertices = header.count_of("vertex") if _is_vertex_list(element, one) else None
        _check_words(words[column], lines[column], one, path, vertices)


def _check_words(words: list[str], lines: list[int], one: Property, path: Path, vertices: int | None) -> None:
    """Check the words of a property: numbers of its type, or indices below `vertices` if given."""
    numbers = _numbers(words)
    wrong = np.isnan(numbers) & [word.lower().strip("+-") != "nan" for word in words]
    if vertices is not None:
        strange = wrong | ~((numbers >= 0) & (numbers < vertices))
        if strange.any():
            row = int(strange.argmax())
            raise InputError(
                f"{path}:{lines[row]}: this face refers to vertex {shortened(words[row])}, but the vertices are 0 to {vertices - 1}."
            )
    limits = np.finfo(one.type) if one.type.kind == "f" else np.iinfo(one.type)
    in_range = (numbers >= limits.min) & (numbers <= limits.max)
    if one.type.kind == "f":
        # readers check for positions and directions that are not finite
        in_range |= np.isnan(numbers) | [word.lower().strip("+-") in ("inf", "infinity") for word in words]
    wrong |= ~in_range
    if wrong.any():
        row = int(wrong.argmax())
        raise InputError(
            f"{path}:{lines[row]}: '{shortened(words[row])}' of '{shortened(one.name)}' is not a valid number of its type; expected "
            f"{limits.min:.4g} to {limits.max:.4g}."
        )


def _numbers(words: list[str]) -> Float[np.ndarray, "N"]:
    """Convert words to numbers, NaN for invalid ones."""
    try:
        # one long word would make the whole array that wide
        if all(len(word) <= 60 for word in words):
            return np.array(words, dtype=str).astype(float)
    except ValueError:
        pass
    return np.array([_number(word) for word in words])


def _number(word: str) -> float:
    try:
        return float("" if "_" in word else word)
    except ValueError:
        return np.nan


def _check_binary(data: bytes, header: Header, path: Path) -> None:
    at = header.end
    for element in header.elements:
        at = _check_block(data, at, element, header, path) if element.count else at


def _check_block(data: bytes, at: int, element: Element, header: Header, path: Path) -> int:
    """Check the numbers of an element from a byte offset, and return the end offset."""
    lengths = _lengths(data, at, element)
    fields, size = [], 0
    for number, one in enumerate(element.properties):
        count = 1
        if one.length_type is not None:
            fields.append((f"length {number}", one.length_type, ()))
            size, count = size + one.length_type.itemsize, lengths.pop(0) if lengths else 0
        fields.append((f"values {number}", one.type, () if one.length_type is None else (count,)))
        size += count * one.type.itemsize
    there = element.count if not size else (len(data) - at) // size
    if there < element.count:
        raise _truncated_error(path, element, max(there, 0))
    if not size:
        return at
    if not element.has_lists:
        return at + element.count * size
    rows = np.frombuffer(data, np.dtype(fields), element.count, at)
    for number, one in enumerate(element.properties):
        if one.length_type is None:
            continue
        if (rows[f"length {number}"] != rows[f"length {number}"][0]).any():
            raise InputError(
                f"{path}: the lists '{shortened(one.name)}' of '{shortened(element.name)}' have different lengths, which is "
                "supported only in text files; write the file as text, or with triangles only."
            )
        if _is_vertex_list(element, one):
            _check_corners(rows[f"values {number}"], header.count_of("vertex"), path)
    return at + element.count * size


def _lengths(data: bytes, at: int, element: Element) -> list[int]:
    """Read the lengths of the lists in the first row; fewer if the file ends before."""
    found = []
    for one in element.properties:
        count = 1
        if one.length_type is not None:
            if at + one.length_type.itemsize > len(data):
                break
            count = max(int(np.frombuffer(data, one.length_type, 1, at)[0]), 0)
            found.append(count)
            at += one.length_type.itemsize
        at += count * one.type.itemsize
    return found


def _check_corners(corners: np.ndarray, vertices: int, path: Path) -> None:
    strange = (corners < 0) | (corners >= vertices)
    if strange.any():
        row, corner = np.argwhere(strange)[0]
        raise InputError(
            f"{path}: face {row} refers to vertex {corners[row, corner]}, but the vertices are 0 to {vertices - 1}."
        )


def _is_vertex_list(element: Element, one: Property) -> bool:
    return element.name == "face" and one.name in _VERTEX_LIST_NAMES


def _truncated_error(where: str | Path, element: Element, there: int) -> InputError:
    return InputError(
        f"{where}: the header declares {element.count} of '{shortened(element.name)}', but {there} follow; the file is cut "
        "short."
    )
