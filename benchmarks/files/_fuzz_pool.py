"""Read files in worker processes with limits of memory and time."""

import contextlib
import multiprocessing
import multiprocessing.connection
import os
import resource
import time
from collections import deque
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

#: seconds of a processor that reading one file may take, and seconds by the clock at which its process is ended
MAX_SECONDS, KILL_SECONDS = 20.0, 60.0
#: bytes that it may add to what the process has, and at which the process gets no more
MAX_MEMORY, MEMORY_LIMIT = 2**30, 4 * 2**30


class Reading(NamedTuple):
    """The outcome of one file."""

    format: str
    path: Path
    outcome: str
    detail: str
    seconds: float
    #: bytes at the most beyond those before
    memory: int


def read_all(
    files: Sequence[tuple[str, Path]], processes: int, seconds: float = MAX_SECONDS
) -> Iterator[Reading]:
    """Read files in a few processes, in any order; a process that dies or takes too long is replaced."""
    context: Any = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["benchmarks._fuzz_read"])
    waiting = deque(files)
    busy: dict[Any, tuple[Any, tuple[str, Path], float]] = {}
    try:
        while waiting or busy:
            while waiting and len(busy) < processes:
                connection, process = _start(context)
                busy[connection] = process, waiting.popleft(), time.monotonic()
                connection.send(busy[connection][1])
            for connection in multiprocessing.connection.wait(list(busy), timeout=0.2):
                process, (format, path), since = busy.pop(connection)
                try:
                    result = connection.recv()  # pyright: ignore[reportAttributeAccessIssue]
                except (EOFError, ConnectionError):
                    process.join()
                    yield Reading(format, path, "crash", f"exit code {process.exitcode}", 0.0, 0)
                    continue
                taken, memory = result[2:]
                outcome = (
                    "too much memory" if memory > MAX_MEMORY else "too slow" if taken > seconds else result[0]
                )
                yield Reading(format, path, outcome, result[1], taken, memory)
                if waiting:
                    busy[connection] = process, waiting.popleft(), time.monotonic()
                    connection.send(busy[connection][1])  # pyright: ignore[reportAttributeAccessIssue]
                else:
                    connection.close()
                    process.join()
            for connection, (process, (format, path), since) in list(busy.items()):
                if time.monotonic() - since > KILL_SECONDS:
                    del busy[connection]
                    process.kill()
                    process.join()
                    yield Reading(format, path, "too slow", "killed", time.monotonic() - since, 0)
    finally:
        for process, *_ in busy.values():
            process.kill()


def _start(context: Any) -> tuple[Any, Any]:
    ours, theirs = context.Pipe()
    process = context.Process(target=_serve, args=(theirs,), daemon=True)
    process.start()
    theirs.close()
    return ours, process


def _serve(connection: Any) -> None:
    """Read files from a connection until it closes."""
    from benchmarks.files._fuzz_read import outcome

    # what libraries say of damaged files is not ours to print
    silence = os.open(os.devnull, os.O_WRONLY)
    os.dup2(silence, 1), os.dup2(silence, 2)
    limit = _status("VmSize") + MEMORY_LIMIT
    resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    with contextlib.suppress(EOFError):
        while True:
            format, path = connection.recv()
            before = _reset_peak_memory()
            start = time.process_time()
            found = outcome(format, path)
            connection.send((*found, time.process_time() - start, _status("VmHWM") - before))


def _reset_peak_memory() -> int:
    """Reset the peak memory of the process, and return its current memory, bytes."""
    Path("/proc/self/clear_refs").write_text("5")
    return _status("VmRSS")


def _status(name: str) -> int:
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith(f"{name}:"):
            return 1024 * int(line.split()[1])
    return 0
