"""The output of the command line, and the progress bar of a long run."""

import contextlib
import sys
import time
from collections.abc import Callable, Iterable, Iterator

from .heartbeat import redirect_status, set_activity, write_line
from .record import current_record, record_table

#: seconds between two progress lines without a terminal
PROGRESS_SECONDS = 5.0


def say(text: str) -> None:
    """Print a line of the result."""
    record = current_record()
    if record is not None:
        record.lines.append(text)
    else:
        write_line(sys.stdout, text)


def warn(text: str) -> None:
    """Print a message line on stderr."""
    record = current_record()
    if record is not None:
        record.warnings.append(text)
    else:
        write_line(sys.stderr, f"jaxcap: {text}")


def report_progress(text: str) -> None:
    """Print a progress line on stderr, which is not part of the output if that is recorded."""
    if current_record() is None:
        write_line(sys.stderr, f"jaxcap: {text}")


def ordinal(number: int) -> str:
    """Write a number with its ending: `21st`, `12th`."""
    ending = {1: "st", 2: "nd", 3: "rd"}.get(number % 10, "th")
    return f"{number}{'th' if number % 100 in (11, 12, 13) else ending}"


def pluralise(count: int, singular: str, plural: str = "") -> str:
    """Format a number and its noun, as in "1 frame" and "3 bodies"; `plural` is the plural if it is not `singular`
    with an s."""
    return f"{count} {singular if count == 1 else plural or singular + 's'}"


def print_table(head: list[str], rows: list[list[str]]) -> None:
    """Print a table with aligned columns, the first to the left."""
    record = current_record()
    if record is not None:
        record_table(record, head, rows)
        return
    widths = [max(len(row[i]) for row in [head, *rows]) for i in range(len(head))]
    for row in [head, *rows]:
        cells = [
            cell.ljust(w) if i == 0 else cell.rjust(w)
            for i, (cell, w) in enumerate(zip(row, widths, strict=True))
        ]
        say("  ".join(cells).rstrip())


def progress(
    frames: Iterable,
    total: int,
    done: int = 0,
    label: str = "tracking",
    noun: str = "frames",
    first: str = "compiled",
) -> Iterator:
    """Iterate over frames (or `noun`) and report progress on stderr: on a terminal a bar with frames per second
    and the time left, otherwise a line every few seconds. `first` describes the state after the first frame."""
    clock = _RateMeter(noun, first)
    yield from (_iterate_with_bar if has_terminal() else _iterate_with_lines)(
        frames, total, done, label, noun, clock
    )


def has_terminal() -> bool:
    """Test if the user watches progress on a terminal."""
    return sys.stderr.isatty() and current_record() is None


@contextlib.contextmanager
def progress_bar(label: str, total: int, done: int) -> Iterator[Callable[..., None]]:
    """Show a progress bar on the terminal and yield its update function `move(done, note, total)`, with None
    for unchanged values."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (
        "{task.description}",
        BarColumn(),
        MofNCompleteColumn(),
        "{task.fields[note]}",
        TimeRemainingColumn(),
    )
    with Progress(*columns, TextColumn("{task.fields[word]}"), console=Console(stderr=True)) as shown:
        task = shown.add_task(label, total=total, completed=done, note="", word="")

        def move(done: int | None = None, note: str | None = None, total: int | None = None) -> None:
            shown.update(task, completed=done, total=total, word="")
            if note is not None:
                shown.update(task, note=note)

        with redirect_status(lambda word: shown.update(task, word=word)):
            yield move


def _iterate_with_bar(
    frames: Iterable, total: int, done: int, label: str, noun: str, clock: "_RateMeter"
) -> Iterator:
    with progress_bar(label, total, done) as move:
        set_activity(label)
        for number, frame in enumerate(frames, done + 1):
            move(number, clock.tick())
            set_activity(label)
            yield frame


def _iterate_with_lines(
    frames: Iterable, total: int, done: int, label: str, noun: str, clock: "_RateMeter"
) -> Iterator:
    printed = time.monotonic()
    set_activity(label)
    for number, frame in enumerate(frames, done + 1):
        rate, now = clock.tick(), time.monotonic()
        if now - printed > PROGRESS_SECONDS:
            report_progress(f"{label}: {number} of {total} {noun}, {rate}, {clock.left(total - number)} left")
            printed = now
        set_activity(f"{label}, {number} of {total} {noun} done")
        yield frame


class _RateMeter:
    """Frames a second, without the first frame, which compiles."""

    def __init__(self, what: str, first: str):
        self.start, self.count, self.what, self.first = time.monotonic(), -1, what, first

    def tick(self) -> str:
        self.count += 1
        if self.count == 0:
            self.start = time.monotonic()
            return self.first
        return f"{self._rate():.1f} {self.what}/s"

    def left(self, frames: int) -> str:
        return f"{frames / self._rate():.0f} s" if self.count > 0 else "unknown time"

    def _rate(self) -> float:
        return self.count / max(time.monotonic() - self.start, 1e-9)
