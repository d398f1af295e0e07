"""Lists of jobs: files that match a pattern, a TOML file, or a table (.csv)."""

import csv
import io
import re
import shlex
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from ...errors import InputError
from ...io.text import read_text
from .patterns import FOLDER, INPUT, NAMED, STEM, is_pattern, match_pattern

#: names in TOML files and tables
COMMAND, INPUTS, JOBS = "command", "inputs", "jobs"
#: delimiters of tables; programs write semicolons where a comma is the decimal mark
DELIMITERS = ",;\t"
_TOML_JOB = re.compile(r"\s*\[\[\s*jobs\s*\]\]\s*(#.*)?")


class ListedJob(NamedTuple):
    """A job of a list: words of a command with named parts, and the values of the names."""

    template: tuple[str, ...]
    values: Mapping[str, str]
    #: where the job is listed, for messages: `path:line`, or its input
    where: str
    #: where the command is written, `path` or `path:line`; empty for the command line
    command_where: str = ""
    #: pattern that the input matches; empty for a job that is listed itself
    pattern: str = ""


def list_jobs(source: str, command: Sequence[str]) -> list[ListedJob]:
    """List the jobs of a pattern, of a `.toml` file, or of a `.csv` table; `command` is used where the list has none.

    **Raises:** `InputError` if there are none, the list is invalid, a job has no command, or `command` is used by no job.
    """
    command = tuple(command)
    if Path(source).suffix.lower() == ".toml":
        jobs = _toml_jobs(source, command)
    elif _is_table(source):
        jobs = _table_jobs(source, command)
    else:
        found = match_pattern(source)
        jobs = [ListedJob(command, values, values[INPUT], pattern=source) for values in found]
    for job in jobs:
        if not job.template:
            raise InputError(
                f"{source if job.pattern else job.where}: there is no verb; give one after `--`: jaxcap batch "
                f"{shlex.quote(source)} -- VERB {{{INPUT if job.pattern else next(iter(job.values), 'name')}}} ..."
            )
    if command and all(job.template != command for job in jobs):
        raise InputError(
            f"{source}: this list has commands, and another one is given after `--`; leave one of them out."
        )
    return jobs


def label_of(job: ListedJob) -> str:
    """Name a job by its input, by its values, or by its line in a list."""
    return job.values.get(INPUT) or ", ".join(filter(None, job.values.values())) or job.where


def _is_table(source: str) -> bool:
    if Path(source).suffix.lower() != ".csv":
        return False
    return not is_pattern(source) or ("{" not in source and Path(source).is_file())


def _toml_jobs(path: str, command: tuple[str, ...]) -> list[ListedJob]:
    text = read_text(path)
    try:
        content = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"{path}: this is not a valid TOML file ({error}); correct it.") from None
    unknown = [name for name in content if name not in (COMMAND, INPUTS, JOBS)]
    if unknown:
        raise InputError(f"{path}: '{unknown[0]}' is unknown; the names are {COMMAND}, {INPUTS} and {JOBS}.")
    template, source = (_words(content[COMMAND], path), path) if COMMAND in content else (command, "")
    patterns = content.get(INPUTS, [])
    patterns = [patterns] if isinstance(patterns, str) else patterns
    rows = content.get(JOBS, [])
    if not (isinstance(patterns, list) and all(isinstance(each, str) for each in patterns)):
        raise InputError(f"{path}: '{INPUTS}' is not a pattern or a list of patterns; write texts.")
    if not (isinstance(rows, list) and all(isinstance(row, dict) for row in rows)):
        raise InputError(f"{path}: '{JOBS}' is not a list of tables; write [[jobs]] above each job.")
    if not patterns and not rows:
        raise InputError(
            f"{path}: there are no jobs in this file; write patterns as '{INPUTS}', or [[jobs]] for each job."
        )
    jobs = [
        ListedJob(template, values, f"{path}: {values[INPUT]}", source, pattern)
        for pattern in patterns
        for values in match_pattern(pattern)
    ]
    for where, row in zip(_toml_places(path, text, len(rows)), rows, strict=True):
        own, place = (_words(row[COMMAND], where), where) if COMMAND in row else (template, source)
        values = {name: _value(value, where) for name, value in row.items() if name != COMMAND}
        jobs.append(ListedJob(own, values, where, place))
    return jobs


def _toml_places(path: str, text: str, count: int) -> list[str]:
    """Return `path:line` of the heading of each job; its number, if the jobs have other headings."""
    lines = [number for number, line in enumerate(text.splitlines(), 1) if _TOML_JOB.fullmatch(line)]
    if len(lines) == count:
        return [f"{path}:{line}" for line in lines]
    return [f"{path}: job {number}" for number in range(1, count + 1)]


def _table_jobs(path: str, command: tuple[str, ...]) -> list[ListedJob]:
    rows = _table_rows(path)
    line, names = next(rows, (1, []))
    if not names:
        raise InputError(
            f"{path}: this table is empty; write a header with the names, and a row for each job."
        )
    double = next((name for name in names if name and names.count(name) > 1), None)
    if double is not None:
        raise InputError(f"{path}:{line}: two columns are named '{double}'; give each another name.")
    if COMMAND not in names:
        _check_columns(f"{path}:{line}", path, names, command)
    jobs = []
    for line, cells in rows:
        where = f"{path}:{line}"
        if len(cells) != len(names):
            raise InputError(
                f"{where}: the number of cells in this row is {len(cells)}, and in the header {len(names)}; write one for each "
                "column."
            )
        values = dict(zip(names, cells, strict=True))
        own = values.pop(COMMAND, "")
        template, place = (_words(own, where), where) if own else (command, "")
        jobs.append(ListedJob(template, values, where, place))
    if not jobs:
        raise InputError(f"{path}: there are no jobs in this table; write a row for each below the header.")
    return jobs


def _table_rows(path: str) -> Iterator[tuple[int, list[str]]]:
    """Iterate over the rows of a table that are not empty, each with the line in which it begins."""
    text = read_text(path)
    head = next(filter(str.strip, text.splitlines()), "")
    delimiter = max(DELIMITERS, key=head.count)
    reader = csv.reader(
        io.StringIO(text, newline=""), delimiter=delimiter, skipinitialspace=True, strict=True
    )
    line = 1
    try:
        for cells in reader:
            cells = [cell.strip() for cell in cells]
            if any(cells):
                yield line, cells
            line = reader.line_num + 1
    except csv.Error as error:
        raise InputError(
            f"{path}:{line}: this row is not one of a table ({error}); correct its quotation marks."
        ) from None


def _check_columns(where: str, path: str, names: Sequence[str], command: Sequence[str]) -> None:
    """Check that a table has the names of a command. Raises `InputError`."""
    lacking = [name for word in command for name in NAMED.findall(word) if name not in names]
    if not lacking:
        return
    remedy = "add it, or use one of these"
    if lacking[0] in (INPUT, STEM, FOLDER):
        remedy = (
            f"add it, or, if {path} is an input itself, give a pattern with a wildcard in quotation marks"
        )
    columns = ", ".join([*names[:8], *(["..."] if len(names) > 8 else [])])
    raise InputError(f"{where}: there is no column '{lacking[0]}'; the columns are {columns}: {remedy}.")


def _words(command: Any, where: str) -> tuple[str, ...]:
    """Split a command into words, as a shell does."""
    try:
        words = shlex.split(command) if isinstance(command, str) else list(command)
    except (ValueError, TypeError) as error:
        raise InputError(f"{where}: the command cannot be split into words ({error}); correct it.") from None
    if not all(isinstance(word, str) for word in words):
        raise InputError(f"{where}: the command has words that are no texts; put them into quotation marks.")
    # written as on the command line
    return tuple(words[1:] if words[:1] == ["jaxcap"] else words)


def _value(value: Any, where: str) -> str:
    if isinstance(value, (list, dict, bool)):
        raise InputError(f"{where}: a value of this job is neither a text nor a number; write one of these.")
    return str(value)
