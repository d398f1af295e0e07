"""Read a C3D file by ezc3d, as a separate program: `python -I -S c3d_process.py FILE FOLDERS...`.

ezc3d is C++ and crashes on some damaged files, or takes all memory. So `c3d_child.py` starts this file, which
imports nothing of jaxcap. It writes a line of JSON to stdout, then points `(3, M, F)` and residuals `(M, F)`
in NumPy's own format. `FOLDERS` are those of NumPy and ezc3d.
"""

import json
import os
import runpy
import sys
from types import SimpleNamespace
from typing import Any

#: limits of bytes and of CPU seconds: a constant and a part per byte, about ten times the use of valid files
MEMORY, MEMORY_PER_BYTE = 512 << 20, 100
SECONDS, SECONDS_PER_BYTE = 10, 2e-6


def main(path: str, folders: list[str]) -> None:
    sys.path[:0] = folders
    out = os.fdopen(os.dup(1), "wb")
    # output of ezc3d must not mix with the results
    os.dup2(2, 1)
    import ezc3d
    import numpy as np

    limits = runpy.run_path(os.path.join(os.path.dirname(__file__), "..", "system", "process_limits.py"))
    size = os.path.getsize(path)
    limits["limit"](int(SECONDS + SECONDS_PER_BYTE * size), MEMORY + MEMORY_PER_BYTE * size)
    try:
        loaded = _load(ezc3d, path)
        points = np.asarray(loaded["data"]["points"], float)[:3]
        residuals = np.asarray(loaded["data"]["meta_points"]["residuals"], float)[0]
        group = loaded["parameters"].get("POINT", {})
        analogs = np.shape(loaded["data"]["analogs"])
        head = {
            "words": {name: _words(entry.get("value")) for name, entry in group.items()},
            "rates": np.ravel(group.get("RATE", {}).get("value", ())).tolist(),
            "analog_values": float(analogs[1] * analogs[2] / max(points.shape[2], 1)),
            "header_rate": float(loaded["header"]["points"]["frame_rate"]),
        }
    except Exception as error:
        head = {"error": f"{type(error).__name__}: {error}"}
        points, residuals = np.zeros((3, 0, 0)), np.zeros((0, 0))
    out.write(json.dumps(head).encode("ascii") + b"\n")
    for array in (points, residuals):
        # an object that can only write: NumPy would seek in a file, which a pipe cannot
        pipe: Any = SimpleNamespace(write=out.write)
        np.lib.format.write_array(pipe, np.ascontiguousarray(array), allow_pickle=False)
    out.close()


def _load(ezc3d: Any, path: str) -> Any:
    try:
        return ezc3d.c3d(path)
    except Exception:
        try:
            return ezc3d.c3d(path, ignore_bad_formatting=True)
        except Exception:
            pass
        raise


def _words(value: object) -> list[str]:
    """Return the words of a parameter; empty for a numeric parameter."""
    return [word for word in value if isinstance(word, str)] if isinstance(value, list) else []


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2:])
