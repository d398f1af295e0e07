"""Time of compilation, of compiled programs and of the host in a function, measured by JAX's profiler.

A trace has an event for each operation of each compiled program. Seconds of programs are the union of these events over
all threads, so nested and parallel operations count once. The rest is the host: Python, NumPy, dispatch and waiting.
"""

import contextlib
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Float

#: durations that JAX reports of compilations, by their names here
COMPILE_EVENTS = {
    "/jax/core/compile/jaxpr_trace_duration": "trace",
    "/jax/core/compile/jaxpr_to_mlir_module_duration": "lower",
    "/jax/core/compile/backend_compile_duration": "compile",
}
#: parts of names of events in which arrays are copied between host and device
TRANSFERS = ("BufferFromHost", "CopyToLiteral", "ToLiteral", "TransferTo", "TransferFrom", "LinearizeInto")


class Program(NamedTuple):
    """One compiled program in a trace."""

    name: str
    calls: int
    seconds: float
    #: floating-point operations and bytes accessed in all calls, as XLA counts them, with one iteration of each loop; NaN if unknown
    flops: float
    bytes: float


class Trace(NamedTuple):
    """The seconds of a traced run."""

    wall: float
    #: in which a compiled program runs
    busy: float
    transfers: float
    programs: list[Program]

    @property
    def host(self) -> float:
        """Seconds in which no compiled program runs and nothing is copied."""
        return max(self.wall - self.busy - self.transfers, 0.0)


class Compilation(NamedTuple):
    """What was compiled in a run."""

    programs: int
    #: seconds of tracing, lowering and compiling
    trace: float
    lower: float
    compile: float


@contextlib.contextmanager
def count_compilations() -> Iterator[list[tuple[str, float]]]:
    """Collect the name and the seconds of each step of each compilation."""
    found: list[tuple[str, float]] = []

    def listen(event: str, seconds: float, **_) -> None:
        if event in COMPILE_EVENTS:
            found.append((COMPILE_EVENTS[event], seconds))

    jax.monitoring.register_event_duration_secs_listener(listen)
    try:
        yield found
    finally:
        jax.monitoring.unregister_event_duration_listener(listen)


def compile_in(run: Callable[[], Any]) -> tuple[float, Compilation]:
    """Run code once; return its wall seconds, and what was compiled."""
    with count_compilations() as found:
        begin = time.perf_counter()
        jax.block_until_ready(run())
        wall = time.perf_counter() - begin
    parts = {name: sum(s for part, s in found if part == name) for name in COMPILE_EVENTS.values()}
    return wall, Compilation(sum(part == "compile" for part, _ in found), **parts)


def trace(run: Callable[[], Any]) -> Trace:
    """Run code under the profiler, without recording Python's functions."""
    options = jax.profiler.ProfileOptions()
    options.python_tracer_level = 0
    with tempfile.TemporaryDirectory() as folder:
        jax.profiler.start_trace(folder, profiler_options=options)
        try:
            begin = time.perf_counter()
            jax.block_until_ready(run())
            wall = time.perf_counter() - begin
        finally:
            jax.profiler.stop_trace()
        (path,) = Path(folder).rglob("*.xplane.pb")
        return _summarise(wall, _read_events(path))


class _Events(NamedTuple):
    """Start and end of events, seconds: of operations by program and call, and of copies."""

    operations: dict[str, list[tuple[float, float]]]
    calls: dict[str, set[int]]
    copies: list[tuple[float, float]]


def _read_events(path: Path) -> _Events:
    # the file of the profiler, as its version in JSON has a million events at most
    found = _Events({}, {}, [])
    for plane in jax.profiler.ProfileData.from_file(str(path)).planes:
        for event in (event for line in plane.lines for event in line.events):
            span = 1e-9 * event.start_ns, 1e-9 * (event.start_ns + event.duration_ns)
            if any(part in event.name for part in TRANSFERS):
                found.copies.append(span)
            elif event.duration_ns > 0 and not event.name.startswith("end: "):
                stats: dict[str, Any] = dict(event.stats)
                if "hlo_module" in stats:
                    found.operations.setdefault(stats["hlo_module"], []).append(span)
                    found.calls.setdefault(stats["hlo_module"], set()).add(stats.get("run_id", 0))
    return found


def _summarise(wall: float, events: _Events) -> Trace:
    costs, programs = _costs(), []
    for name, own in events.operations.items():
        calls = len(events.calls[name])
        flops, size = costs.get(name, (np.nan, np.nan))
        programs.append(Program(name, calls, union_seconds(_spans(own)), calls * flops, calls * size))
    programs.sort(key=lambda program: -program.seconds)
    spans = _spans([span for own in events.operations.values() for span in own])
    busy = union_seconds(spans)
    transfers = union_seconds(np.concatenate([spans, _spans(events.copies)])) - busy
    return Trace(wall, busy, transfers, programs)


def _spans(spans: list[tuple[float, float]]) -> Float[np.ndarray, "E 2"]:
    return np.array(spans, float).reshape(-1, 2)


def union_seconds(spans: Float[np.ndarray, "E 2"]) -> float:
    """Compute the length of the union of time spans."""
    spans = spans[np.argsort(spans[:, 0])]
    ends = np.maximum.accumulate(spans[:, 1])
    before = np.concatenate([spans[:1, 0], ends[:-1]])
    return float(np.maximum(ends - np.maximum(spans[:, 0], before), 0.0).sum())


def _costs() -> dict[str, tuple[float, float]]:
    """Collect operations and bytes of a call of every compiled program, by its name; the largest of programs of one name."""
    found: dict[str, tuple[float, float]] = {}
    for executable in jax.devices()[0].client.live_executables():
        cost = executable.cost_analysis() or {}
        own = (float(cost.get("flops", np.nan)), float(cost.get("bytes accessed", np.nan)))
        for module in executable.hlo_modules():
            found[module.name] = max(found.get(module.name, own), own)
    return found
