"""The rate of the scans: from the user, from the scanner's file next to them, or the default."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, NamedTuple

from ...errors import InputError
from ...io.depth.recording import is_recording, recorded_rate
from ...io.depth.recordings import open_recording
from ...io.kinds import identify
from ...io.text import check_frame_rate, read_json
from ..console.console import say
from ..console.options import arg
from .folder import HEADER

#: default rate, frames per second
DEFAULT_RATE = 30.0
#: relative difference of rates that are the same, as clocks of cameras measure them
SAME_RATE = 0.02
ScanRate = Annotated[
    float | None,
    arg(
        metavar="RATE",
        help_behavior_hint="",
        help=f"Frames per second. Default: the rate in {HEADER} in the folder of the clouds or of a recording, else {DEFAULT_RATE:g}.",
    ),
]


class Rate(NamedTuple):
    """Frames per second, and the file with this rate; None if it is not from a file."""

    frames: float
    file: Path | None = None


def find_rate(requested: float | None, clouds: Sequence[str], images: Sequence[str] = ()) -> Rate:
    """Return the given rate, or else that of the scans, or else the default.

    The scanner's file is in the folder of the clouds, or next to the folder of each camera's depth `images`. Recordings
    contain the times of their images.

    **Raises:** `InputError` if the rate next to the clouds is invalid, or there are several.
    """
    if requested is not None:
        return Rate(requested)
    folders = dict.fromkeys([*map(_folder_of, clouds), *(_folder_of(one).parent for one in images)])
    found = [rate for folder in folders if (rate := _read_rate(folder / HEADER)) is not None]
    for path in map(Path, filter(is_recording, images)):
        recorded = recorded_rate(open_recording(path))
        found += [] if recorded is None else [Rate(recorded, path)]
    other = next((r for r in found if abs(r.frames - found[0].frames) > SAME_RATE * found[0].frames), None)
    if other is not None:
        raise InputError(
            f"{other.file}: the rate of these scans is {other.frames:g}, and that of {found[0].file} is {found[0].frames:g} "
            "frames per second; give one rate with --rate."
        )
    return found[0] if found else Rate(DEFAULT_RATE)


def _folder_of(source: str) -> Path:
    return Path(source) if Path(source).is_dir() else Path(source).parent


def print_rate(rate: Rate) -> None:
    """Print a rate that was read from a file."""
    if rate.file is not None:
        say(f"{rate.frames:g} frames per second, from {rate.file}")


def _read_rate(path: Path) -> Rate | None:
    """Read the rate in a scanner's file; None if there is no such file, or it has none."""
    if identify(path) != "scan":
        return None
    rate = read_json(path).get("rate")
    if rate is None:
        return None
    if isinstance(rate, bool) or not isinstance(rate, int | float):
        raise InputError(
            f"{path}: the rate of the scans is {rate!r:.40}; expected a number; correct it, or give --rate."
        )
    try:
        return Rate(check_frame_rate(float(rate), str(path)), path)
    except OverflowError:
        raise InputError(
            f"{path}: the rate of the scans has too many digits; write a shorter number, or give --rate."
        ) from None
