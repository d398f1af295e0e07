"""No silence: where nothing is said for some seconds, a line on stderr says what the program does and for how long.

What it does is what `doing` said last. The library says it by `logging`, at the level INFO: it prints nothing by itself, and
knows best when it begins to search, to adjust or to write.
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

#: seconds of silence before a word, and between two looks at the clock
QUIET, LOOK = 7.0, 1.0
#: what JAX runs while it traces, lowers and compiles a function
_COMPILERS = tuple(
    os.path.join("jax", "_src", *names)
    for names in (("compiler.py",), ("interpreters", "partial_eval.py"), ("interpreters", "mlir.py"))
)


class _Voice:
    """All lines of the program, one at a time, and when the last was."""

    def __init__(self):
        self.lock = threading.RLock()
        self.last = self.since = time.monotonic()
        self.doing = ""
        #: what shows a word instead of a line: the bar of a run
        self.shown: Callable[[str], None] | None = None
        #: nobody waits: a window is open
        self.resting = False
        #: a line on a terminal that the next one replaces
        self._passing = False

    def line(self, stream: Any, text: str) -> None:
        with self.lock:
            self.clear()
            stream.write(text + "\n")
            stream.flush()
            self.last = time.monotonic()

    def passing(self, text: str) -> None:
        """A word that is of no more interest when the next one comes."""
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

    def beat(self) -> None:
        """Say a word where it has been quiet for long."""
        with self.lock:
            now = time.monotonic()
            if self.resting or now - self.last < QUIET:
                return
            compiles = ", compiling, which is done once" if _compiles() else ""
            self.passing(f"{self.doing or 'working'}{compiles}: {now - self.since:.0f} s")


_VOICE = _Voice()
write_line = _VOICE.line


def doing(text: str) -> None:
    """Say what the program does from now on; shown only where it takes long."""
    _VOICE.doing, _VOICE.since = text, time.monotonic()


@contextlib.contextmanager
def break_silence() -> Iterator[None]:
    """Break every silence until the end of the block."""
    stop, log, handler = threading.Event(), logging.getLogger("jaxcap"), _Listener(logging.INFO)
    before = log.level

    def watch() -> None:
        while not stop.wait(LOOK):
            _VOICE.beat()

    thread = threading.Thread(target=watch, daemon=True, name="heartbeat")
    _VOICE.last = time.monotonic()
    doing("starting")
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
        _VOICE.clear()


@contextlib.contextmanager
def shown_by(show: Callable[[str], None]) -> Iterator[None]:
    """Give words to a bar that is on the terminal, instead of writing them below it."""
    _VOICE.shown = show
    try:
        yield
    finally:
        _VOICE.shown = None


@contextlib.contextmanager
def resting() -> Iterator[None]:
    """Say nothing while a window is open."""
    _VOICE.resting = True
    try:
        yield
    finally:
        _VOICE.resting = False


class _Listener(logging.Handler):
    """Takes what the library logs for what the program does."""

    def emit(self, record: logging.LogRecord) -> None:
        doing(record.getMessage())


def _compiles() -> bool:
    """Whether a thread is inside of JAX's compiler."""
    for frame in sys._current_frames().values():
        while frame is not None:
            if frame.f_code.co_filename.endswith(_COMPILERS):
                return True
            frame = frame.f_back
    return False
