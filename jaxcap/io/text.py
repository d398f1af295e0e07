"""Shared parts of the readers of text formats: numbered lines, numbers, JSON, clear errors."""

import json
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from ..errors import InputError

#: the largest length, angle or time that is read; its square is finite in single precision too
MAX_NUMBER = 1e15
#: lower and upper bound of frame rates, frames per second
RATE_RANGE = (1e-6, 1e6)


def read_text(path: str | Path) -> str:
    """Read a text file with any line ending, with or without a byte order mark.

    Bytes that are not UTF-8 are read as Latin-1.

    **Raises:** `InputError` if there is no such file, it is a folder, it cannot be read, or it is binary.
    """
    path = Path(path)
    try:
        raw = path.read_bytes()
    except FileNotFoundError:
        raise InputError(f"{path}: there is no such file; check the path.") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); give a readable file.") from None
    except ValueError:
        raise InputError(f"{str(path)!r}: this is not a valid file name; check the path.") from None
    if b"\0" in raw[:4096]:
        raise InputError(f"{path}: this is a binary file; give a text file.")
    try:
        return raw.decode("utf-8-sig")
    except UnicodeDecodeError:
        return raw.decode("latin-1")


def numbered_lines(text: str, comment: str = "#") -> Iterator[tuple[int, str]]:
    """Iterate over `(line number, line)` of all lines that are not blank after comments are removed."""
    for number, line in enumerate(text.splitlines(), 1):
        line = line.split(comment, 1)[0].strip()
        if line:
            yield number, line


def parse_floats(words: list[str], where: str, quantity: str) -> list[float]:
    """Parse `words` as finite floats; `where` is `path:line` and `quantity` names the numbers in errors.

    Raises `InputError`.
    """
    numbers = []
    for word in words:
        try:
            # Python accepts 1_000, but no program writes numbers in this form
            numbers.append(float("" if "_" in word else word))
        except ValueError:
            raise InputError(
                f"{where}: '{shortened(word)}' in {quantity} is not a number; write a number."
            ) from None
        if not math.isfinite(numbers[-1]):
            raise InputError(
                f"{where}: '{shortened(word)}' in {quantity} is not finite; write a finite number."
            )
        if abs(numbers[-1]) > MAX_NUMBER:
            raise InputError(
                f"{where}: '{shortened(word)}' in {quantity} is too large; write a number of at most {MAX_NUMBER:g}."
            )
    return numbers


def parse_float_table(words: list[str]) -> Float[np.ndarray, "N"] | None:
    """Parse many words at once as `parse_floats` does; None if one of them is invalid."""
    # one long word would make the whole array that wide
    if any(len(word) > 60 or "_" in word for word in words):
        return None
    try:
        numbers = np.array(words, dtype=str).astype(float)
    except ValueError:
        return None
    return numbers if (np.abs(numbers) <= MAX_NUMBER).all() else None


def parse_int(word: str, where: str, quantity: str) -> int:
    """Parse an integer of at most 18 digits; `where` is `path:line` and `quantity` names it in errors.

    Raises `InputError`.
    """
    try:
        number = int("" if "_" in word else word)
    except ValueError:
        raise InputError(
            f"{where}: '{shortened(word)}' for {quantity} is not a whole number; write a whole number."
        ) from None
    if abs(number) >= 10**18:
        raise InputError(
            f"{where}: '{shortened(word)}' for {quantity} is too large; write a number of at most 18 digits."
        )
    return number


def shortened(word: str) -> str:
    """Shorten a long word for a message by removing its middle."""
    return word if len(word) <= 60 else f"{word[:40]}...{word[-10:]}"


def check_frame_rate(rate: float, where: str) -> float:
    """Check a frame rate and return it. Raises `InputError`, which begins with `where`."""
    if not RATE_RANGE[0] <= rate <= RATE_RANGE[1]:
        raise InputError(
            f"{where}: the rate is {rate} frames per second; expected a number from {RATE_RANGE[0]:g} to {RATE_RANGE[1]:g}."
        )
    return float(rate)


def read_json(path: str | Path) -> Any:
    """Read a JSON file.

    **Raises:** `InputError` with file and line if there is no such file or it is not JSON; also if it is
    nested too deeply or has numbers of too many digits. The caller checks for NaN and infinity.
    """
    return parse_json(read_text(path), path)


def parse_json(text: str | bytes, where: str | Path) -> Any:
    """Parse JSON text; `where` begins the message. Errors as in `read_json`."""
    try:
        return json.loads(text)
    except json.JSONDecodeError as error:
        raise InputError(
            f"{where}:{error.lineno}: this is not JSON ({error.msg}); correct this line."
        ) from None
    except UnicodeDecodeError:
        raise InputError(
            f"{where}: this is not JSON, which is text in UTF-8; write the file again."
        ) from None
    except RecursionError:
        raise InputError(f"{where}: this JSON is nested too deeply; write it with fewer levels.") from None
    except ValueError:
        raise InputError(
            f"{where}: this JSON has numbers of too many digits; write shorter numbers."
        ) from None


class Words:
    """A sequence of the words of a file, each with its line, for grammars that do not depend on lines."""

    def __init__(self, path: str | Path):
        self.path, self._at = path, 0
        self._words = [
            (number, word) for number, line in numbered_lines(read_text(path)) for word in line.split()
        ]

    @property
    def left(self) -> int:
        """The number of words that are not yet taken."""
        return len(self._words) - self._at

    @property
    def where(self) -> str:
        """`path:line` of the word that was taken last."""
        return f"{self.path}:{self._words[max(self._at - 1, 0)][0] if self._words else 1}"

    def take(self, expected: str) -> str:
        """Return the next word; `expected` names it in the error at the end of the file."""
        if not self.left:
            raise InputError(f"{self.where}: the file ends before {expected}; it is cut short.")
        self._at += 1
        return self._words[self._at - 1][1]

    def floats(self, count: int, quantity: str) -> list[float]:
        """Return the next `count` words as finite numbers."""
        return [
            parse_floats([self.take(f"a number of {quantity}")], self.where, quantity)[0]
            for _ in range(count)
        ]

    def header(self, keyword: str) -> int:
        """Read the keyword that begins a file and return the number after it."""
        word = self.take(keyword)
        if word.upper() != keyword:
            raise InputError(
                f"{self.where}: the file begins with '{shortened(word)}'; expected {keyword}; give another file."
            )
        return parse_int(self.take("a number"), self.where, f"the number after {keyword}")
