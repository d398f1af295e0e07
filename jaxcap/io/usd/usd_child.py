"""Test in a separate process whether OpenUSD can read a file without crashing."""

from pathlib import Path

from ...errors import InputError
from ..system.own_process import ProcessFailed, run_program

_PROGRAM = Path(__file__).with_name("usd_process.py")
#: time limit in seconds: a constant and a part for each byte; the limit of CPU time in the process is lower
_WAIT, _WAIT_PER_BYTE = 60, 2e-5


def check_usd(path: Path) -> None:
    """Check in another process that OpenUSD can read all of a file, as a damaged file may crash it (0.4 s).

    **Raises:** `InputError` if OpenUSD crashes, or takes too long or too much memory.
    """
    wait = _WAIT + _WAIT_PER_BYTE * path.stat().st_size
    try:
        run_program(_PROGRAM, path, ("pxr",), wait, "convert it to .glb")
    except ProcessFailed as error:
        reason = str(error).replace("pxr", "OpenUSD")
        raise InputError(
            f"{path}: this USD file is incomplete or damaged ({reason}); export it again."
        ) from None
