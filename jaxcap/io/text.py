"""What the readers of text formats share: lines with their numbers, floats, clean errors."""

import math
from collections.abc import Iterator
from pathlib import Path

from ..errors import InputError

#: metres in one unit of each name
UNITS: dict[str, float] = {"m": 1.0, "dm": 0.1, "cm": 0.01, "mm": 0.001, "in": 0.0254, "ft": 0.3048}


def unit_scale(unit: str | float) -> float:
    """Metres in one `unit`, which is one of `UNITS` or that number itself, as text too.

    **Raises:** `InputError` for anything else.
    """
    if isinstance(unit, str):
        if unit in UNITS:
            return UNITS[unit]
        try:
            unit = float(unit)
        except ValueError:
            raise InputError(
                f"'{unit}' is not a unit of length; give one of {', '.join(UNITS)}, or the metres in one, as 0.0564."
            ) from None
    if not (math.isfinite(unit) and unit > 0):
        raise InputError(f"{unit} metres cannot be a unit of length; give a number above zero.")
    return float(unit)


def read_text(path: str | Path) -> str:
    """A text file's content; any line ending, a byte order mark, and bytes that are not
    UTF-8 (taken as Latin-1) are fine.

    **Raises:** `InputError` where there is no such file, it is a folder, cannot be read, or
    is binary.
    """
    path = Path(path)
    try:
        raw = path.read_bytes()
    except FileNotFoundError:
        raise InputError(f"{path}: there is no such file; check the path.") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); give a readable file.") from None
    if b"\0" in raw[:4096]:
        raise InputError(f"{path}: this is a binary file; give a text file.")
    try:
        return raw.decode("utf-8-sig")
    except UnicodeDecodeError:
        return raw.decode("latin-1")


def numbered_lines(text: str, comment: str = "#") -> Iterator[tuple[int, str]]:
    """`(line number, line)` of all lines that hold more than blanks and a comment."""
    for number, line in enumerate(text.splitlines(), 1):
        line = line.split(comment, 1)[0].strip()
        if line:
            yield number, line


def parse_floats(words: list[str], where: str, what: str) -> list[float]:
    """Finite floats of `words`; `where` is `path:line` and `what` names them in the error."""
    numbers = []
    for word in words:
        try:
            numbers.append(float(word))
        except ValueError:
            raise InputError(f"{where}: '{word}' in {what} is not a number; write a number there.") from None
        if not math.isfinite(numbers[-1]):
            raise InputError(f"{where}: '{word}' in {what} is not finite; write a finite number there.")
    return numbers


def parse_int(word: str, where: str, what: str) -> int:
    """A whole number; `where` is `path:line` and `what` names it in the error."""
    try:
        return int(word)
    except ValueError:
        raise InputError(f"{where}: '{word}' for {what} is not a whole number.") from None


class Words:
    """The words of a file one by one, each with its line, for grammars without lines."""

    def __init__(self, path: str | Path):
        self.path, self._at = path, 0
        self._words = [
            (number, word) for number, line in numbered_lines(read_text(path)) for word in line.split()
        ]

    @property
    def left(self) -> int:
        """How many words have not been taken."""
        return len(self._words) - self._at

    @property
    def where(self) -> str:
        """`path:line` of the word that was taken last."""
        return f"{self.path}:{self._words[max(self._at - 1, 0)][0] if self._words else 1}"

    def take(self, what: str) -> str:
        """The next word; the end of the file is an error that says `what` belongs there."""
        if not self.left:
            raise InputError(f"{self.where}: the file ends where {what} belongs; it is cut short.")
        self._at += 1
        return self._words[self._at - 1][1]

    def floats(self, count: int, what: str) -> list[float]:
        """The next `count` words as finite numbers."""
        return [parse_floats([self.take(f"a number of {what}")], self.where, what)[0] for _ in range(count)]

    def header(self, keyword: str) -> int:
        """The keyword that a file begins with, and the number behind it."""
        word = self.take(keyword)
        if word.upper() != keyword:
            raise InputError(
                f"{self.where}: '{word[:40]}' stands where {keyword} belongs, with which such a file begins; give another file."
            )
        return parse_int(self.take("a number"), self.where, f"the number behind {keyword}")
