"""Comparison of the numbers in the names of images that are one frame, such as those of two cameras."""

import itertools
import re
import warnings
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from ...errors import InputError

#: counts of frames increase by less than this; times of a clock, such as milliseconds, by more
MAX_STEP = 10
#: times of clocks are compared if at least this share of the shorter sequence's is also in the other one
MIN_COMMON = 0.5
#: largest share of gaps in a sequence whose numbers count its frames
MAX_GAP_SHARE = 0.25


class _Numbers(NamedTuple):
    """The numbers that differ from name to name in a sequence."""

    values: list[tuple[int, ...]]
    #: they count frames, with gaps where frames are missing; otherwise they may be times of a clock
    are_counts: bool


def check_same_numbers(one: Sequence[Path], other: Sequence[Path]) -> None:
    """Check that images at the same position of two sequences have the same number in their names.

    Names without numbers, and times of two clocks, are not compared: nothing but their order is known. A sequence that
    counts from 0 and one that counts from 1 have the same frames if both have the same length and no gaps.

    **Raises:** `InputError` for the first pair with different numbers.

    **Warns:** `UserWarning` if one sequence counts from 0 and the other one from 1.
    """
    first, second = _find_numbers(one), _find_numbers(other)
    if first is None or second is None:
        return
    common = len(set(first.values) & set(second.values))
    if not (first.are_counts and second.are_counts) and common < MIN_COMMON * min(len(one), len(other)):
        return
    if {_start(first), _start(second)} == {0, 1} and len(one) == len(other):
        warnings.warn(
            f"{one[0]} and {other[0]}: one sequence counts from 0 and the other one from 1; their images are paired in this "
            "order, as none is missing. Check that the first ones were taken at one time.",
            stacklevel=3,
        )
        return
    for path, partner, here, there in zip(one, other, first.values, second.values, strict=False):
        if here != there:
            raise InputError(
                f"{path} and {partner} would be one frame, but the numbers in their names differ; an image may be missing. "
                "Leave out images without a partner, and give images of one frame the same number."
            )


def warn_of_gaps(paths: Sequence[Path]) -> None:
    """Warn if few numbers are missing in the names of a sequence that counts frames: later frames would be too early.

    **Warns:** `UserWarning`.
    """
    numbers = _find_numbers(paths)
    if numbers is None or not numbers.are_counts:
        return
    pairs = list(itertools.pairwise(range(len(paths))))
    steps = [numbers.values[after][0] - numbers.values[before][0] for before, after in pairs]
    usual = Counter(steps).most_common(1)[0][0]
    gaps = [pair for pair, step in zip(pairs, steps, strict=True) if step > usual]
    if gaps and len(gaps) <= MAX_GAP_SHARE * len(steps):
        before, after = gaps[0]
        others = f" and in {len(gaps) - 1} other place{'s' if len(gaps) > 2 else ''}" if len(gaps) > 1 else ""
        warnings.warn(
            f"images are missing between {paths[before]} and {paths[after].name}{others}; all images count as successive frames, so later "
            "ones are too early. Add the missing images, or copies of their neighbours.",
            stacklevel=3,
        )


def _find_numbers(paths: Sequence[Path]) -> _Numbers | None:
    """Find the numbers that differ from name to name; None if there are none, or the names differ in letters too."""
    parts = [re.split(r"(\d+)", str(path)) for path in paths]
    if len(paths) < 2 or len({tuple(words[::2]) for words in parts}) > 1:
        return None
    rows = [tuple(map(int, words[1::2])) for words in parts]
    changing = [column for column, values in enumerate(zip(*rows, strict=True)) if len(set(values)) > 1]
    if not changing:
        return None
    values = [tuple(row[column] for column in changing) for row in rows]
    gaps = [after[0] - before[0] for before, after in itertools.pairwise(values)]
    step = min(gaps)
    return _Numbers(
        values, len(changing) == 1 and 0 < step < MAX_STEP and all(gap % step == 0 for gap in gaps)
    )


def _start(numbers: _Numbers) -> int | None:
    """Return the first number of a sequence without gaps that increases by one; None for others."""
    first = numbers.values[0][0]
    expected = [(number,) for number in range(first, first + len(numbers.values))]
    return first if numbers.values == expected else None
