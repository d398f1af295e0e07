"""The output of a verb as data, for runs that no user watches."""

import contextlib
from collections.abc import Iterator, Mapping, Sequence
from contextvars import ContextVar
from dataclasses import dataclass, field


@dataclass
class Record:
    """The output of one run of a verb."""

    #: lines of the result
    lines: list[str] = field(default_factory=list)
    #: messages
    warnings: list[str] = field(default_factory=list)
    #: rows of the printed tables, each with its cells by the names of the columns
    rows: list[dict[str, str]] = field(default_factory=list)
    #: numbers that the verb gives by name, in metres, radians and seconds
    figures: dict[str, float] = field(default_factory=dict)


# of a context and not of the process: several threads may run verbs
_RECORD: ContextVar[Record | None] = ContextVar("record", default=None)


@contextlib.contextmanager
def record_output() -> Iterator[Record]:
    """Collect the output of the verb that runs in this block, in place of printing it."""
    record = Record()
    token = _RECORD.set(record)
    try:
        yield record
    finally:
        _RECORD.reset(token)


def current_record() -> Record | None:
    """Return the record of this run; None if its output is printed."""
    return _RECORD.get()


def give_figures(figures: Mapping[str, int | float]) -> None:
    """Give numbers of the result by name to the record of this run, if there is one; nothing is printed."""
    record = current_record()
    if record is not None:
        record.figures.update({name: float(value) for name, value in figures.items()})


def record_table(record: Record, head: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Add a table to a record."""
    record.rows.extend(dict(zip(head, row, strict=True)) for row in rows)
