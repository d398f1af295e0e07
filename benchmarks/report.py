"""Time and report benchmarks: a timer that separates compilation, and the final line of JSON.

    timer = Timer()
    result = timer(tracked, body, clouds)
    finish("track", figures={"error_mm": 4.2}, limits={"error_mm": ("<=", 5.0)}, seconds=timer.seconds)

`figures` are the measured values, `limits` their bounds. The line on standard output
is JSON; everything else that a benchmark says goes to standard error by `progress`.
"""

import json
import math
import operator
import os
import platform
import resource
import sys
import time
from collections.abc import Callable, Mapping
from typing import Any, NoReturn

import jax
import numpy as np

OPERATORS = {"<=": operator.le, ">=": operator.ge, "<": operator.lt, ">": operator.gt, "==": operator.eq}


class Timer:
    """Wall seconds of calls, with the first call of each function, which compiles, counted separately.

    Every call waits for its result, so that queued work is included. The whole first call counts as compilation: at the
    sizes of benchmarks its run is short in comparison. A function compiles again for other shapes: use one timer per shape.
    """

    def __init__(self):
        self.compile = 0.0
        self.runs: list[float] = []
        self._seen: set[Any] = set()

    def __call__(self, function: Callable, *args, **kwargs):
        """Time `function(*args, **kwargs)`, and return its computed result."""
        start = time.perf_counter()
        result = jax.block_until_ready(function(*args, **kwargs))
        taken = time.perf_counter() - start
        if function in self._seen:
            self.runs.append(taken)
        else:
            self._seen.add(function)
            self.compile += taken
        return result

    @property
    def median(self) -> float:
        """Median seconds of the calls after the first ones."""
        return float(np.median(self.runs)) if self.runs else math.nan

    @property
    def seconds(self) -> dict[str, float]:
        """`compile` (all first calls), `run` (all later ones) and `median_run`."""
        return {"compile": self.compile, "run": float(sum(self.runs)), "median_run": self.median}


def median_seconds(function: Callable, *args, repeats: int = 30) -> tuple[float, float]:
    """Measure `(median, first)` wall seconds of `repeats` calls after a first one that compiles."""
    timer = Timer()
    for _ in range(repeats + 1):
        timer(function, *args)
    return timer.median, timer.compile


def progress(text: str) -> None:
    """Print progress on standard error."""
    print(text, file=sys.stderr, flush=True)


def missed_limits(figures: Mapping[str, Any], limits: Mapping[str, tuple[str, float]]) -> list[str]:
    """List the names of violated limits; missing and NaN figures violate them."""
    return [
        name
        for name, (sign, bound) in limits.items()
        if name not in figures or not OPERATORS[sign](float(figures[name]), bound)
    ]


def finish(
    name: str,
    figures: Mapping[str, Any],
    limits: Mapping[str, tuple[str, float]] | None = None,
    sizes: Mapping[str, Any] | None = None,
    seconds: Mapping[str, Any] | None = None,
) -> NoReturn:
    """Print the line of JSON and exit, with code 1 if a limit is violated, else 0.

    **Arguments:** `figures`, measured values by names with their unit (`error_mm`); `limits` of some of them, as
    `(sign, bound)` with a sign of `<= >= < > ==`; `sizes` of the problem; `seconds`, such as `Timer().seconds`.
    """
    limits = limits or {}
    missed = missed_limits(figures, limits)
    for miss in missed:
        sign, bound = limits[miss]
        progress(f"{name}: {miss} is {figures.get(miss, 'missing')}; expected {sign} {bound:g}.")
    line = {
        "benchmark": name,
        "passed": not missed,
        "missed": missed,
        "figures": _plain(figures),
        "limits": {key: [sign, bound] for key, (sign, bound) in limits.items()},
        "sizes": _plain(sizes or {}),
        "seconds": _plain(seconds or {}),
        "peak_memory_mb": peak_memory(),
        "machine": machine(),
    }
    print(json.dumps(line), flush=True)
    sys.exit(1 if missed else 0)


def peak_memory() -> dict[str, float]:
    """Measure the largest resident memory of this process, and of the largest of its child processes, megabytes."""
    units = 2**20 if sys.platform == "darwin" else 2**10
    kinds = {"process": resource.RUSAGE_SELF, "largest_child": resource.RUSAGE_CHILDREN}
    return {name: round(resource.getrusage(kind).ru_maxrss / units, 1) for name, kind in kinds.items()}


def machine() -> dict[str, Any]:
    """Describe the machine: versions, and the load average of the last minute."""
    return {
        "python": platform.python_version(),
        "jax": jax.__version__,
        "numpy": np.__version__,
        "backend": jax.default_backend(),
        "x64": bool(jax.config.jax_enable_x64),  # pyright: ignore[reportAttributeAccessIssue]
        "cores": os.cpu_count(),
        "load": round(os.getloadavg()[0], 2),
    }


def _plain(value):
    """Convert numbers and containers to JSON; numbers have six digits, and are text if not finite."""
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, bool | np.bool_):
        return bool(value)
    if isinstance(value, int | np.integer):
        return int(value)
    if isinstance(value, float | np.floating) or getattr(value, "shape", None) == ():
        number = float(value)
        return float(f"{number:.6g}") if math.isfinite(number) else str(number)
    return value.tolist() if hasattr(value, "tolist") else value
