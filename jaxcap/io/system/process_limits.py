"""Limits that a program puts on itself before it reads a file by a library that damaged files may bring down.

Run by path, as these programs import nothing of jaxcap.
"""

import contextlib
import os


def limit(seconds: int, memory: int) -> None:
    """Limit memory and time, where the system can; leave no dump, and show no window, of a crash."""
    if os.name == "nt":
        import ctypes

        ctypes.windll.kernel32.SetErrorMode(3)  # pyright: ignore[reportAttributeAccessIssue]
        return
    import resource

    # at the first limit of CPU comes SIGXCPU, which says why, at the second SIGKILL
    limits = {"RLIMIT_CORE": (0, 0), "RLIMIT_CPU": (seconds, seconds + 5), "RLIMIT_AS": (memory, memory)}
    for name, limit in limits.items():
        # macOS knows RLIMIT_AS and refuses it
        with contextlib.suppress(OSError, ValueError):
            resource.setrlimit(getattr(resource, name), limit)
