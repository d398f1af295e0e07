"""Test in a separate process whether OpenUSD can read a file without crashing."""

from pathlib import Path

from ...errors import InputError
from ..system.own_process import Ended, run_program

_PROGRAM = Path(__file__).with_name("usd_process.py")
#: seconds to wait for a file of no bytes, and more for each byte; the process limits its own seconds of CPU to less
_WAIT, _WAIT_PER_BYTE = 60, 2e-5


def check_usd(path: Path) -> None:
    """Check that OpenUSD can look at all of a file: a damaged one ends another process and not this one (0.4 s).

    **Raises:** `InputError` where OpenUSD crashes, or takes too long or too much memory.
    """
    wait = _WAIT + _WAIT_PER_BYTE * path.stat().st_size
    try:
        run_program(_PROGRAM, path, ("pxr",), wait, "convert it to .glb")
    except Ended as error:
        reason = str(error).replace("pxr", "OpenUSD")
        raise InputError(f"{path}: this is not a whole USD file ({reason}); export it again.") from None
