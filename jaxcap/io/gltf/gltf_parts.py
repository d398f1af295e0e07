"""The JSON of a glTF file, in which nothing is taken for granted: every value is checked as it is asked for."""

from typing import Any

import numpy as np
from jaxtyping import Float

from ...errors import InputError
from ..text import LARGEST, shortened


class Part:
    """An object of the JSON, with its place for messages, such as `a.glb: nodes[3]`.

    All methods raise `InputError` where a value is another than they are asked for; None and empty lists stand for
    values that are not there.
    """

    def __init__(self, content: Any, where: str):
        self.where = where
        if not isinstance(content, dict):
            raise InputError(f"{where} is {_quoted(content)}; it must be an object with keys.")
        self.content: dict[str, Any] = content

    def __contains__(self, name: str) -> bool:
        return self.content.get(name) is not None

    def part(self, name: str) -> "Part":
        """An object; an empty one where it is not there."""
        return Part(self.content.get(name) or {}, self._at(name))

    def parts(self, name: str) -> list["Part"]:
        """A list of objects."""
        return [Part(value, f"{self._at(name)}[{number}]") for number, value in enumerate(self.values(name))]

    def values(self, name: str) -> list[Any]:
        value = self.content.get(name)
        if value is not None and not isinstance(value, list):
            raise self.wrong(name, "a list")
        return value or []

    def word(self, name: str, default: str = "") -> str:
        value = self.content.get(name)
        if value is not None and not isinstance(value, str):
            raise self.wrong(name, "a word")
        return default if value is None else value

    def whole(self, name: str, default: int = 0) -> int:
        """A whole number of at least zero."""
        value = self.content.get(name, default)
        if not _is_index(value):
            raise self.wrong(name, "a whole number of at least 0")
        return value

    def index(self, name: str, count: int) -> int | None:
        """The number of one of `count` things."""
        value = self.content.get(name)
        if value is not None and not (_is_index(value) and value < count):
            raise self.wrong(name, f"a number below {count}")
        return value

    def indices(self, name: str, count: int) -> list[int]:
        """A list of the numbers of some of `count` things."""
        values = self.values(name)
        if not all(_is_index(value) and value < count for value in values):
            raise self.wrong(name, f"a list of numbers below {count}")
        return values

    def numbers(self, name: str, count: int) -> Float[np.ndarray, "N"] | None:
        """So many finite numbers."""
        values = self.content.get(name)
        if values is None:
            return None
        fits = isinstance(values, list) and len(values) == count
        if not fits or not all(_is_number(value) for value in values):
            raise self.wrong(name, f"a list of {count} finite numbers")
        return np.array(values, float)

    def wrong(self, name: str, wanted: str) -> InputError:
        """The error that a value is not what it should be."""
        return InputError(
            f"{self.where}: '{name}' is {_quoted(self.content.get(name))}; it must be {wanted}."
        )

    def _at(self, name: str) -> str:
        # the file's name ends with a colon, and a place in it goes on with a full stop
        return f"{self.where}.{name}" if ": " in self.where else f"{self.where}: {name}"


def _is_index(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and 0 <= value < 2**40


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) <= LARGEST


def _quoted(value: Any) -> str:
    return "not there" if value is None else shortened(repr(value))
