"""Tables and reports for other programs: CSV and JSON, written atomically."""

import csv
import io
import json
from collections.abc import Mapping, Sequence
from pathlib import Path

from .system.atomic import write_text


def write_csv(path: str | Path, rows: Sequence[Mapping[str, object]]) -> None:
    """Write rows of equal keys as CSV with a header. Raises `InputError` if the file cannot be written."""
    text = io.StringIO()
    writer = csv.DictWriter(text, list(rows[0]) if rows else [], lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    write_text(path, text.getvalue())


def write_json(path: str | Path, content: Mapping[str, object]) -> None:
    """Write data as JSON, with one line for each row of a table; numbers that are not finite become null.

    **Raises:** `InputError` if the file cannot be written.
    """
    entries = (f"{json.dumps(str(name))}: {_written(value)}" for name, value in content.items())
    write_text(path, "{\n " + ",\n ".join(entries) + "\n}\n")


def _written(content) -> str:
    if content and isinstance(content, list) and all(isinstance(row, dict) for row in content):
        # without indentation Python's encoder is five times faster
        return "[\n  " + ",\n  ".join(json_text(row) for row in content) + "\n ]"
    return json_text(content, indent=1).replace("\n", "\n ")


def json_text(content, indent: int | None = None) -> str:
    """Format data as JSON; numbers that are not finite become null."""
    try:
        return json.dumps(content, indent=indent, allow_nan=False)
    except ValueError:
        return json.dumps(_replace_nonfinite(content), indent=indent, allow_nan=False)


def _replace_nonfinite(content):
    if isinstance(content, Mapping):
        return {str(name): _replace_nonfinite(value) for name, value in content.items()}
    if isinstance(content, (list, tuple)):
        return [_replace_nonfinite(value) for value in content]
    if isinstance(content, float) and not abs(content) < float("inf"):
        return None
    return content
