"""Lists of jobs: files that match a pattern, a TOML file, or a table (.csv)."""

import csv
import io
import shlex
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from ...errors import InputError
from ...io.text import read_text
from .patterns import INPUT, match_pattern

#: names in TOML files and tables
COMMAND, INPUTS, JOBS = "command", "inputs", "jobs"


class ListedJob(NamedTuple):
    """A job of a list: words of a command with named parts, and the values of the names."""

    template: tuple[str, ...]
    values: Mapping[str, str]


def list_jobs(source: str, command: Sequence[str]) -> list[ListedJob]:
    """List the jobs of a pattern, of a `.toml` file, or of a `.csv` table; `command` is used where the list has none.

    **Raises:** `InputError` if there are none, the list is invalid, or a job has no command.
    """
    suffix = Path(source).suffix.lower()
    if suffix == ".toml":
        jobs = _toml_jobs(source, tuple(command))
    elif suffix == ".csv" and Path(source).is_file() and "{" not in source:
        jobs = _table_jobs(source, tuple(command))
    else:
        jobs = [ListedJob(tuple(command), values) for values in match_pattern(source)]
    if not jobs:
        raise InputError(f"{source}: there are no jobs in this file; add some.")
    for number, job in enumerate(jobs):
        if not job.template:
            raise InputError(
                f"{source}: job {number} has no command; give one after `--`, such as -- markers solve subject.npz {{input}} "
                "-o out/{stem}.bvh."
            )
    return jobs


def _toml_jobs(path: str, command: tuple[str, ...]) -> list[ListedJob]:
    text = read_text(path)
    try:
        content = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"{path}: this is not a valid TOML file ({error}); correct it.") from None
    unknown = [name for name in content if name not in (COMMAND, INPUTS, JOBS)]
    if unknown:
        raise InputError(f"{path}: '{unknown[0]}' is unknown; the names are {COMMAND}, {INPUTS} and {JOBS}.")
    template = _words(content[COMMAND], path) if COMMAND in content else command
    patterns = content.get(INPUTS, [])
    patterns = [patterns] if isinstance(patterns, str) else patterns
    rows = content.get(JOBS, [])
    if not (isinstance(patterns, list) and all(isinstance(each, str) for each in patterns)):
        raise InputError(f"{path}: '{INPUTS}' is not a pattern or a list of patterns; write texts.")
    if not (isinstance(rows, list) and all(isinstance(row, dict) for row in rows)):
        raise InputError(f"{path}: '{JOBS}' is not a list of tables; write [[jobs]] above each job.")
    jobs = [ListedJob(template, values) for pattern in patterns for values in match_pattern(pattern)]
    for number, row in enumerate(rows):
        own = _words(row[COMMAND], path) if COMMAND in row else template
        where = f"{path}: job {number}"
        values = {name: _value(value, where) for name, value in row.items() if name != COMMAND}
        jobs.append(ListedJob(own, values))
    return jobs


def _table_jobs(path: str, command: tuple[str, ...]) -> list[ListedJob]:
    reader = csv.DictReader(io.StringIO(read_text(path)))
    jobs = []
    for number, row in enumerate(reader):
        if None in row or None in row.values():
            raise InputError(
                f"{path}: row {number} has not as many cells as the header; write one for each column."
            )
        own = _words(row[COMMAND], path) if row.get(COMMAND) else command
        jobs.append(ListedJob(own, {name: value for name, value in row.items() if name != COMMAND}))
    return jobs


def _words(command: Any, path: str) -> tuple[str, ...]:
    """Split a command into words, as a shell does."""
    try:
        words = shlex.split(command) if isinstance(command, str) else list(command)
    except (ValueError, TypeError) as error:
        raise InputError(f"{path}: a command cannot be split into words ({error}); correct it.") from None
    if not all(isinstance(word, str) for word in words):
        raise InputError(f"{path}: a command has words that are no texts; put them into quotation marks.")
    # written as on the command line
    return tuple(words[1:] if words[:1] == ["jaxcap"] else words)


def _value(value: Any, where: str) -> str:
    if isinstance(value, (list, dict, bool)):
        raise InputError(f"{where} has a value that is neither a text nor a number; write one of these.")
    return str(value)


def label_of(job: ListedJob, number: int) -> str:
    """Name a job by its input, or by its values."""
    return job.values.get(INPUT) or ", ".join(job.values.values()) or f"job {number}"
