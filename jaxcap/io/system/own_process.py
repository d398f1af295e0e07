"""Programs in separate processes, for libraries that a damaged file may crash."""

import importlib.util
import os
import signal
import subprocess
import sys
from pathlib import Path

from ...errors import InputError


def run_program(program: Path, path: Path, modules: tuple[str, ...], time_limit: float, advice: str) -> bytes:
    """Run a program on a file in a new process of the same Python, which imports `modules` and nothing else.

    This is a plain program and not `multiprocessing`, which imports the caller's `__main__` again or copies
    its threads. Messages name the first of `modules` as the library; `advice` is the advice if no process
    can be started.

    **Raises:** `ProcessFailed` if the program fails or does not end; `InputError` if there is no Python to start;
    `ImportError` if a module is not installed.
    """
    try:
        done = subprocess.run(
            [
                _python(path, modules[0], advice),
                "-I",
                "-S",
                str(program),
                str(path.absolute()),
                *_folders(modules),
            ],
            stdin=subprocess.DEVNULL,
            capture_output=True,
            timeout=time_limit,
            # one thread: threads of BLAS, which is not used, take a large share of the allowed memory
            env={**os.environ, "OPENBLAS_NUM_THREADS": "1", "MKL_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"},
            creationflags=getattr(subprocess, "CREATE_NO_WINDOW", 0),
        )
    except subprocess.TimeoutExpired:
        raise ProcessFailed(f"{modules[0]} does not end within {time_limit:.0f} s") from None
    except OSError as error:
        raise InputError(
            f"{path}: the process that reads it cannot be started ({error.strerror or error}); close other programs, or "
            f"{advice}."
        ) from None
    if done.returncode:
        raise ProcessFailed(_describe_failure(modules[0], done.returncode, done.stderr))
    return done.stdout


class ProcessFailed(Exception):
    """The failure of a program; the message describes it in a few words."""


def _describe_failure(library: str, code: int, stderr: bytes) -> str:
    """Describe how a process failed, in a few words."""
    if code < 0:
        name = signal.Signals(-code).name if -code in set(signal.Signals) else f"signal {-code}"
        if name == "SIGXCPU":
            return f"{library} does not end with this file"
        return f"{library} crashes with this file, {name}"
    lines = stderr.decode("utf-8", "replace").strip().splitlines()
    return (
        f"{library} fails with this file, {lines[-1]}"
        if lines
        else f"{library} crashes with this file, code {code:#x}"
    )


def _folders(modules: tuple[str, ...]) -> list[str]:
    """Return the folders from which modules are imported. Raises `ImportError` if one is not installed."""
    found = []
    for name in modules:
        spec = importlib.util.find_spec(name)
        if spec is None or spec.origin is None:
            raise ModuleNotFoundError(f"No module named '{name}'", name=name)
        found.append(str(Path(spec.origin).parents[1]))
    return list(dict.fromkeys(found))


def _python(path: Path, library: str, advice: str) -> str:
    """Return the path of the running Python. Raises `InputError` if Python is embedded in another program."""
    names = [sys.executable, getattr(sys, "_base_executable", "")]
    names += [os.path.join(sys.exec_prefix, "bin", "python3"), os.path.join(sys.exec_prefix, "python.exe")]
    if not getattr(sys, "frozen", False):
        for name in names:
            if name and "py" in os.path.basename(name).lower() and os.path.isfile(name):
                return name
    raise InputError(
        f"{path}: {library} reads files in a separate process, and no Python program was found to start it; {advice}."
    )
