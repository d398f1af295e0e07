"""Ctrl-C during the import of libraries."""

import contextlib
import os
import signal
import threading
from collections.abc import Iterator

from .errors import EXIT_INTERRUPTED


@contextlib.contextmanager
def exit_on_interrupt() -> Iterator[None]:
    """Exit on Ctrl-C without a traceback: libraries catch the exception during import, or convert it to their
    own, and there are no results to save yet."""
    ours = threading.current_thread() is threading.main_thread()
    if not ours or signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        yield
        return
    signal.signal(signal.SIGINT, _exit_now)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, signal.default_int_handler)


def _exit_now(*_) -> None:
    os.write(2, b"\njaxcap: stopped\n")
    os._exit(EXIT_INTERRUPTED)
