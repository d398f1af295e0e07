"""Status lines on stderr: after some seconds without output, a line names the current activity and its
duration.

The activity is the last argument of `set_activity`. The library reports it by `logging`, at the level INFO: it
prints nothing itself, but knows when it begins to search, to adjust or to write.
"""

import contextlib
import logging
import os
import shutil
import sys
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

#: seconds without output before a status line, and between two checks
SILENCE_SECONDS, CHECK_SECONDS = 7.0, 1.0
#: source files of JAX that trace, lower and compile a function
_COMPILERS = tuple(
    os.path.join("jax", "_src", *names)
    for names in (("compiler.py",), ("interpreters", "partial_eval.py"), ("interpreters", "mlir.py"))
)


class _Output:
    """All lines of the program, one at a time, and when the last was."""

    def __init__(self):
        self.lock = threading.RLock()
        self.last = self.activity_start = time.monotonic()
        self.activity = ""
        #: callback that shows a status in the progress bar of a run instead of a line
        self.shown: Callable[[str], None] | None = None
        #: True while a window is open, as no user waits for output
        self.is_paused = False
        #: whether the last line on the terminal is to be replaced
        self._passing = False

    def line(self, stream: Any, text: str) -> None:
        with self.lock:
            self.clear()
            stream.write(text + "\n")
            stream.flush()
            self.last = time.monotonic()

    def write_status(self, text: str) -> None:
        """Print a temporary status, which the next line replaces."""
        with self.lock:
            self.last = time.monotonic()
            if self.shown is not None:
                self.shown(text)
            elif sys.stderr.isatty():
                self.clear()
                sys.stderr.write(f"jaxcap: {text}"[: shutil.get_terminal_size().columns - 1])
                sys.stderr.flush()
                self._passing = True
            else:
                self.line(sys.stderr, f"jaxcap: {text}")

    def clear(self) -> None:
        if self._passing:
            sys.stderr.write("\r\x1b[2K")
            sys.stderr.flush()
            self._passing = False

    def write_activity_if_silent(self) -> None:
        """Print a status after a long time without output."""
        with self.lock:
            now = time.monotonic()
            if self.is_paused or now - self.last < SILENCE_SECONDS:
                return
            compiles = ", compiling, which is done once" if _is_compiling() else ""
            self.write_status(f"{self.activity or 'working'}{compiles}: {now - self.activity_start:.0f} s")


_OUTPUT = _Output()
write_line, write_status = _OUTPUT.line, _OUTPUT.write_status


def set_activity(text: str) -> None:
    """Set the current activity; it is printed only if it takes long."""
    _OUTPUT.activity, _OUTPUT.activity_start = text, time.monotonic()


@contextlib.contextmanager
def periodic_status() -> Iterator[None]:
    """Print status lines after long times without output, until the end of the block."""
    stop, log, handler = threading.Event(), logging.getLogger("jaxcap"), _Listener(logging.INFO)
    before = log.level

    def watch() -> None:
        while not stop.wait(CHECK_SECONDS):
            _OUTPUT.write_activity_if_silent()

    thread = threading.Thread(target=watch, daemon=True, name="heartbeat")
    _OUTPUT.last = time.monotonic()
    set_activity("starting")
    log.addHandler(handler)
    log.setLevel(logging.INFO)
    thread.start()
    try:
        yield
    finally:
        stop.set()
        thread.join()
        log.removeHandler(handler)
        log.setLevel(before)
        _OUTPUT.clear()


@contextlib.contextmanager
def redirect_status(show: Callable[[str], None]) -> Iterator[None]:
    """Show statuses in a progress bar on the terminal instead of below it."""
    _OUTPUT.shown = show
    try:
        yield
    finally:
        _OUTPUT.shown = None


@contextlib.contextmanager
def pause_status() -> Iterator[None]:
    """Print no statuses while a window is open."""
    _OUTPUT.is_paused = True
    try:
        yield
    finally:
        _OUTPUT.is_paused = False


class _Listener(logging.Handler):
    """Report log messages of the library as the current activity."""

    def emit(self, record: logging.LogRecord) -> None:
        set_activity(record.getMessage())


def _is_compiling() -> bool:
    """Check if a thread runs JAX's compiler."""
    for frame in sys._current_frames().values():
        while frame is not None:
            if frame.f_code.co_filename.endswith(_COMPILERS):
                return True
            frame = frame.f_back
    return False
