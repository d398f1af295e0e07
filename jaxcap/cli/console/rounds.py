"""The progress bar of an iterative run."""

import contextlib
import time
from collections.abc import Callable
from types import TracebackType

from .console import has_terminal, progress_bar, report_progress
from .heartbeat import set_activity


class RoundProgress:
    """On a terminal a bar of rounds with the objective, else a line a round; all on stderr.

    `total` rounds are the most; a run that ends well before them leaves the bar full."""

    def __init__(self, total: int, done: int = 0, label: str = "learning"):
        self.total, self.done, self.label, self.start = total, done, label, time.monotonic()
        self._move: Callable[..., None] | None = None
        self._open = contextlib.ExitStack()

    def __enter__(self) -> "RoundProgress":
        if has_terminal():
            self._move = self._open.enter_context(progress_bar(self.label, self.total, self.done))
        set_activity(self.label)
        return self

    def update(self, done: int, note: str) -> None:
        """Report that `done` rounds are complete."""
        self.done = done
        if self._move is not None:
            self._move(done, note)
        else:
            seconds = time.monotonic() - self.start
            report_progress(f"{self.label}: round {done} of at most {self.total}, {note}, {seconds:.0f} s")
        set_activity(f"{self.label}, round {done + 1}")

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._move is not None and kind is None:
            self._move(total=self.done)
        self._open.close()
