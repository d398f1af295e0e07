"""What the command line says, and the bar of a long run."""

import sys
import time
from collections.abc import Iterable, Iterator

#: seconds between two lines where there is no terminal to draw a bar on
QUIET = 5.0


def say(text: str) -> None:
    """A line of the result."""
    sys.stdout.write(text + "\n")
    sys.stdout.flush()


def warn(text: str) -> None:
    """A line beside the result."""
    sys.stderr.write(f"jaxcap: {text}\n")
    sys.stderr.flush()


def table(head: list[str], rows: list[list[str]]) -> None:
    """A table with aligned columns, the first to the left."""
    widths = [max(len(row[i]) for row in [head, *rows]) for i in range(len(head))]
    for row in [head, *rows]:
        cells = [
            cell.ljust(w) if i == 0 else cell.rjust(w)
            for i, (cell, w) in enumerate(zip(row, widths, strict=True))
        ]
        say("  ".join(cells).rstrip())


def progress(
    frames: Iterable, total: int, done: int = 0, label: str = "tracking", what: str = "frames"
) -> Iterator:
    """Pass frames, or `what` else there is, through; on a terminal with a bar, frames a second and the time
    left, and else with a line every few seconds, all on stderr."""
    yield from (_bar if sys.stderr.isatty() else _lines)(frames, total, done, label, what)


def _bar(frames: Iterable, total: int, done: int, label: str, what: str) -> Iterator:
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[rate]}"),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=Console(stderr=True)) as bar:
        task = bar.add_task(label, total=total, completed=done, rate="compiling")
        clock = _Clock(what)
        for frame in frames:
            bar.update(task, advance=1, rate=clock.tick())
            yield frame


def _lines(frames: Iterable, total: int, done: int, label: str, what: str) -> Iterator:
    clock, told = _Clock(what), time.monotonic()
    for number, frame in enumerate(frames, done + 1):
        rate, now = clock.tick(), time.monotonic()
        if now - told > QUIET:
            warn(f"{label}: {number} of {total} {what}, {rate}, {clock.left(total - number)} left")
            told = now
        yield frame


class _Clock:
    """Frames a second, without the first frame, which compiles."""

    def __init__(self, what: str):
        self.start, self.count, self.what = time.monotonic(), -1, what

    def tick(self) -> str:
        self.count += 1
        if self.count == 0:
            self.start = time.monotonic()
            return "compiled"
        return f"{self._rate():.1f} {self.what}/s"

    def left(self, frames: int) -> str:
        return f"{frames / self._rate():.0f} s" if self.count > 0 else "unknown time"

    def _rate(self) -> float:
        return self.count / max(time.monotonic() - self.start, 1e-9)
