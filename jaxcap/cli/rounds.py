"""The bar of a run that goes round by round."""

import sys
import time
from types import TracebackType

from .say import warn


class Rounds:
    """On a terminal a bar of rounds with the objective, else a line a round; all on stderr.

    `total` rounds are the most; a run that ends well before them leaves the bar full."""

    def __init__(self, total: int, done: int = 0, label: str = "learning"):
        self.total, self.done, self.label, self.start = total, done, label, time.monotonic()
        self._bar = self._task = None

    def __enter__(self) -> "Rounds":
        if sys.stderr.isatty():
            from rich.console import Console
            from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

            columns = (
                TextColumn("{task.description}"),
                BarColumn(),
                MofNCompleteColumn(),
                TextColumn("{task.fields[note]}"),
                TimeElapsedColumn(),
            )
            self._bar = Progress(*columns, console=Console(stderr=True))
            self._bar.start()
            self._task = self._bar.add_task(self.label, total=self.total, completed=self.done, note="")
        return self

    def tell(self, done: int, note: str) -> None:
        """That so many rounds are done."""
        self.done = done
        if self._bar is not None and self._task is not None:
            self._bar.update(self._task, completed=done, note=note)
        else:
            seconds = time.monotonic() - self.start
            warn(f"{self.label}: round {done} of at most {self.total}, {note}, {seconds:.0f} s")

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._bar is not None and self._task is not None:
            if kind is None:
                self._bar.update(self._task, total=self.done)
            self._bar.stop()
