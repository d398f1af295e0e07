"""C3D files by ezc3d in a process of its own, which a damaged file may end without ending this one."""

import importlib.util
import io
import json
import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from ..errors import InputError

_PROGRAM = Path(__file__).with_name("c3d_process.py")
#: seconds to wait for a file of no bytes, and more for each byte; the process limits its own seconds of CPU to less
_WAIT, _WAIT_PER_BYTE = 60, 2e-5


class Loaded(NamedTuple):
    """What ezc3d reads of a C3D file."""

    points: Float[np.ndarray, "3 M F"]
    residuals: Float[np.ndarray, "M F"]
    #: words of the parameters of the group POINT, by name; none where a parameter has numbers
    words: dict[str, list[str]]
    #: frames a second, of the group POINT where it has them, and of the header
    rates: list[float]
    header_rate: float


def load_c3d(path: Path) -> Loaded:
    """Read a C3D file by ezc3d in a new process of the same Python, which imports ezc3d and NumPy alone (0.2 s).

    A plain program and not `multiprocessing`, which imports the caller's `__main__` once more or copies its threads.

    **Raises:** `InputError` where ezc3d refuses the file, ends with its process, takes too long or too much memory; or
    where there is no Python to start.
    """
    wait = _WAIT + _WAIT_PER_BYTE * path.stat().st_size
    try:
        done = subprocess.run(
            [_python(path), "-I", "-S", str(_PROGRAM), str(path.absolute()), *_folders()],
            stdin=subprocess.DEVNULL,
            capture_output=True,
            timeout=wait,
            # one thread: threads of BLAS, which is not used, take much of the memory that is allowed
            env={**os.environ, "OPENBLAS_NUM_THREADS": "1", "MKL_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"},
            creationflags=getattr(subprocess, "CREATE_NO_WINDOW", 0),
        )
    except subprocess.TimeoutExpired:
        raise _damaged(path, f"ezc3d does not end within {wait:.0f} s") from None
    except OSError as error:
        raise InputError(
            f"{path}: no process can be started to read it ({error.strerror or error}); close other programs, or "
            "convert it to .trc."
        ) from None
    if done.returncode:
        raise _damaged(path, _ending(done.returncode, done.stderr))
    return _parse(path, done.stdout)


def _parse(path: Path, answer: bytes) -> Loaded:
    stream = io.BytesIO(answer)
    try:
        head = json.loads(stream.readline())
        if "error" in head:
            raise _damaged(path, head["error"])
        points, residuals = (np.lib.format.read_array(stream, allow_pickle=False) for _ in range(2))
    except InputError:
        raise
    except ValueError:
        raise _damaged(path, "ezc3d ended before all was read") from None
    return Loaded(points, residuals, head["words"], head["rates"], head["header_rate"])


def _damaged(path: Path, reason: str) -> InputError:
    reason = " ".join(reason.split())[:120].rstrip(". ")
    return InputError(f"{path}: this is not a whole C3D file ({reason}); copy or export it again.")


def _ending(code: int, said: bytes) -> str:
    """How a process ended that ended badly."""
    if code < 0:
        name = signal.Signals(-code).name if -code in set(signal.Signals) else f"signal {-code}"
        if name == "SIGXCPU":
            return "ezc3d does not come to an end with it"
        return f"ezc3d crashes with it, {name}"
    lines = said.decode("utf-8", "replace").strip().splitlines()
    return f"ezc3d ends with it, {lines[-1]}" if lines else f"ezc3d crashes with it, code {code:#x}"


def _folders() -> list[str]:
    """The folders that NumPy and ezc3d are imported from here. Raises `ImportError` where there is no ezc3d."""
    found = importlib.util.find_spec("ezc3d")
    if found is None or found.origin is None:
        raise ModuleNotFoundError("No module named 'ezc3d'", name="ezc3d")
    return list(dict.fromkeys(str(Path(file).parents[1]) for file in (found.origin, np.__file__)))


def _python(path: Path) -> str:
    """The Python that runs this. Raises `InputError` where another program has it inside."""
    names = [sys.executable, getattr(sys, "_base_executable", "")]
    names += [os.path.join(sys.exec_prefix, "bin", "python3"), os.path.join(sys.exec_prefix, "python.exe")]
    if not getattr(sys, "frozen", False):
        for name in names:
            if name and "py" in os.path.basename(name).lower() and os.path.isfile(name):
                return name
    raise InputError(
        f"{path}: C3D files are read in a process of their own, and there is no Python to start; convert it to .trc."
    )
