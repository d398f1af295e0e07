"""The numbers of a job's reports: of the JSON files among its outputs."""

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from .staging import Staging

#: largest report that is read, bytes, and how deep its tables may lie
MAX_BYTES, MAX_DEPTH = 4 << 20, 3


def collect_figures(staging: Staging) -> dict[str, float]:
    """Collect the numbers of the JSON files that a job wrote, by their names joined with dots; lists are left out."""
    figures = {}
    for folder in (*staging.folders.values(), *(path.parent for path in staging.uploads)):
        for path in sorted(folder.rglob("*.json")):
            figures.update(_numbers_of(path))
    return figures


def _numbers_of(path: Path) -> dict[str, float]:
    try:
        if path.stat().st_size > MAX_BYTES:
            return {}
        content = json.loads(path.read_text("utf-8"))
    except (OSError, ValueError, RecursionError):
        return {}
    return dict(_numbers(content, "", MAX_DEPTH)) if isinstance(content, dict) else {}


def _numbers(content: Mapping[str, Any], prefix: str, depth: int) -> Iterator[tuple[str, float]]:
    for name, value in content.items():
        if isinstance(value, bool):
            continue
        if isinstance(value, (int, float)):
            yield f"{prefix}{name}", float(value)
        elif isinstance(value, dict) and depth > 1:
            yield from _numbers(value, f"{prefix}{name}.", depth - 1)
