"""C3D files by ezc3d in a separate process, which a damaged file may crash."""

import io
import json
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from ...errors import InputError
from ..system.own_process import ProcessFailed, run_program

_PROGRAM = Path(__file__).with_name("c3d_process.py")
#: time limit in seconds: a constant and a part for each byte; the limit of CPU time in the process is lower
_WAIT, _WAIT_PER_BYTE = 60, 2e-5


class C3dContents(NamedTuple):
    """The data that ezc3d reads from a C3D file."""

    points: Float[np.ndarray, "3 M F"]
    residuals: Float[np.ndarray, "M F"]
    #: words of the parameters of the group POINT, by name; empty for numeric parameters
    text_parameters: dict[str, list[str]]
    #: frames per second, from the group POINT if present, and from the header
    rates: list[float]
    header_rate: float
    #: number of analogue values that were taken to follow the points of each frame
    analog_values: float


def load_c3d(path: Path) -> C3dContents:
    """Read a C3D file by ezc3d in a new process of the same Python (0.2 s).

    The process imports ezc3d and NumPy only.

    **Raises:** `InputError` if ezc3d rejects the file, crashes, or takes too long or too much memory, or if
    there is no Python to start.
    """
    wait = _WAIT + _WAIT_PER_BYTE * path.stat().st_size
    try:
        return _parse(path, run_program(_PROGRAM, path, ("ezc3d", "numpy"), wait, "convert it to .trc"))
    except ProcessFailed as error:
        raise _damaged_error(path, str(error)) from None


def _parse(path: Path, answer: bytes) -> C3dContents:
    stream = io.BytesIO(answer)
    try:
        head = json.loads(stream.readline())
        if "error" in head:
            raise _damaged_error(path, head["error"])
        points, residuals = (np.lib.format.read_array(stream, allow_pickle=False) for _ in range(2))
    except InputError:
        raise
    except ValueError:
        raise _damaged_error(path, "ezc3d ended before the whole file was read") from None
    return C3dContents(
        points, residuals, head["words"], head["rates"], head["header_rate"], head["analog_values"]
    )


def _damaged_error(path: Path, reason: str) -> InputError:
    reason = " ".join(reason.split())[:120].rstrip(". ")
    return InputError(f"{path}: this C3D file is incomplete or damaged ({reason}); copy or export it again.")
