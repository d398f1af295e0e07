"""Validated access to the JSON of a glTF file: every value is checked when it is read."""

from typing import Any

import numpy as np
from jaxtyping import Float

from ...errors import InputError
from ..text import MAX_NUMBER, shortened


class Part:
    """A JSON object with its path for messages, such as `a.glb: nodes[3]`.

    All methods raise `InputError` if a value has the wrong type; they return None or an empty list for
    missing values.
    """

    def __init__(self, content: Any, where: str):
        self.where = where
        if not isinstance(content, dict):
            raise InputError(f"{where} is {_quoted(content)}; expected an object with keys.")
        self.content: dict[str, Any] = content

    def __contains__(self, name: str) -> bool:
        return self.content.get(name) is not None

    def part(self, name: str) -> "Part":
        """Get an object; an empty one if it is missing."""
        value = self.content.get(name)
        return Part({} if value is None else value, self._key_path(name))

    def parts(self, name: str) -> list["Part"]:
        """Get a list of objects."""
        return [
            Part(value, f"{self._key_path(name)}[{number}]") for number, value in enumerate(self.values(name))
        ]

    def values(self, name: str) -> list[Any]:
        value = self.content.get(name)
        if value is not None and not isinstance(value, list):
            raise self.type_error(name, "a list")
        return value or []

    def text(self, name: str, default: str = "") -> str:
        value = self.content.get(name)
        if value is not None and not isinstance(value, str):
            raise self.type_error(name, "text")
        return default if value is None else value

    def integer(self, name: str, default: int = 0) -> int:
        """Get a non-negative integer."""
        value = self.content.get(name, default)
        if not _is_index(value):
            raise self.type_error(name, "a whole number of at least 0")
        return value

    def index(self, name: str, count: int) -> int | None:
        """Get an index below `count`."""
        value = self.content.get(name)
        if value is not None and not (_is_index(value) and value < count):
            raise self.type_error(name, f"a number below {count}")
        return value

    def indices(self, name: str, count: int) -> list[int]:
        """Get a list of indices below `count`."""
        values = self.values(name)
        if not all(_is_index(value) and value < count for value in values):
            raise self.type_error(name, f"a list of numbers below {count}")
        return values

    def numbers(self, name: str, count: int) -> Float[np.ndarray, "N"] | None:
        """Get a list of `count` finite numbers."""
        values = self.content.get(name)
        if values is None:
            return None
        fits = isinstance(values, list) and len(values) == count
        if not fits or not all(_is_number(value) for value in values):
            raise self.type_error(name, f"a list of {count} finite numbers")
        return np.array(values, float)

    def type_error(self, name: str, expected: str) -> InputError:
        """Return the error for a value of the wrong type."""
        return InputError(
            f"{self.where}: '{name}' is {_quoted(self.content.get(name))}; expected {expected}."
        )

    def _key_path(self, name: str) -> str:
        # the file's name ends with a colon, and a path in it continues with a full stop
        return f"{self.where}.{name}" if ": " in self.where else f"{self.where}: {name}"


def _is_index(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and 0 <= value < 2**40


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) <= MAX_NUMBER


def _quoted(value: Any) -> str:
    return "missing" if value is None else shortened(repr(value))
