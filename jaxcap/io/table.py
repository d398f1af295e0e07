"""Tables and reports for other programs: CSV and JSON, which appear whole or not at all."""

import csv
import io
import json
from collections.abc import Mapping, Sequence
from pathlib import Path

from .atomic import write_text


def write_csv(path: str | Path, rows: Sequence[Mapping[str, object]]) -> None:
    """Rows of equal keys, with a head. Raises `InputError` where the file cannot be written."""
    text = io.StringIO()
    writer = csv.DictWriter(text, list(rows[0]) if rows else [], lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    write_text(path, text.getvalue())


def write_json(path: str | Path, content: object) -> None:
    """Anything that JSON can say; a number that is not finite becomes null. Raises `InputError`
    where the file cannot be written."""
    write_text(path, json.dumps(_finite(content), indent=1, allow_nan=False) + "\n")


def _finite(content):
    if isinstance(content, Mapping):
        return {str(name): _finite(value) for name, value in content.items()}
    if isinstance(content, (list, tuple)):
        return [_finite(value) for value in content]
    if isinstance(content, float) and not abs(content) < float("inf"):
        return None
    return content
