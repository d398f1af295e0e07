"""Limits of memory and time that a program sets for itself before it reads a possibly damaged file.

Run by path, as these programs import nothing of jaxcap.
"""

import contextlib
import os


def limit(seconds: int, memory: int) -> None:
    """Limit memory and time, if the system can; suppress core dumps and crash windows."""
    if os.name == "nt":
        import ctypes

        ctypes.windll.kernel32.SetErrorMode(3)  # pyright: ignore[reportAttributeAccessIssue]
        return
    import resource

    # SIGXCPU, which gives the reason, comes at the first limit of CPU time, and SIGKILL at the second
    limits = {"RLIMIT_CORE": (0, 0), "RLIMIT_CPU": (seconds, seconds + 5), "RLIMIT_AS": (memory, memory)}
    for name, limit in limits.items():
        # macOS has RLIMIT_AS but rejects it
        with contextlib.suppress(OSError, ValueError):
            resource.setrlimit(getattr(resource, name), limit)
