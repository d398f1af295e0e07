"""The statistics of each frame of a run, in the `statistics.json` of its folder."""

from pathlib import Path
from typing import NamedTuple

from ...errors import InputError
from ..system.reader_errors import reader_of
from ..text import MAX_NUMBER, read_json


class RunStatistics(NamedTuple):
    """Statistics by frame."""

    #: standard deviation of the tracker's mixture, metres
    sigmas: tuple[float, ...]
    #: name of the cloud
    clouds: tuple[str, ...]


@reader_of("the statistics of a run")
def read_statistics(path: str | Path) -> RunStatistics:
    """Read the statistics of a run.

    **Raises:** `InputError` if the file has no list of frames, or a frame lacks its numbers.
    """
    content = read_json(path)
    rows = content.get("frames") if isinstance(content, dict) else None
    if not isinstance(rows, list):
        raise InputError(
            f"{path}: the file has no list 'frames'; expected the statistics of a run; remove the file."
        )
    for number, row in enumerate(rows):
        if not (isinstance(row, dict) and _is_length(row.get("sigma")) and isinstance(row.get("cloud"), str)):
            raise InputError(f"{path}: frame {number} has no 'sigma' or no 'cloud'; remove the file.")
    return RunStatistics(tuple(float(row["sigma"]) for row in rows), tuple(row["cloud"] for row in rows))


def _is_length(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and 0 <= value <= MAX_NUMBER
