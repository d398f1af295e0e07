"""Ctrl-C while libraries are imported."""

import contextlib
import os
import signal
import threading
from collections.abc import Iterator

from .errors import STOPPED


@contextlib.contextmanager
def leaving_at_once() -> Iterator[None]:
    """Let Ctrl-C end the program without a word of Python: libraries that are being imported swallow the exception, or turn
    it into one of theirs, and there is nothing to keep yet."""
    ours = threading.current_thread() is threading.main_thread()
    if not ours or signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        yield
        return
    signal.signal(signal.SIGINT, _leave)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, signal.default_int_handler)


def _leave(*_) -> None:
    os.write(2, b"\njaxcap: stopped\n")
    os._exit(STOPPED)
