"""The solved trials of a run, in one file that is replaced atomically after each of them."""

import json
from collections.abc import Mapping
from pathlib import Path

from ...errors import InputError
from ...io.archives.journal import check_same_header
from ...io.table import write_json


def read_solved(path: Path, header: Mapping[str, object]) -> dict[str, str]:
    """Read the digests of the solved trials, by their paths; empty if the file does not exist.

    **Raises:** `InputError` if the file is invalid, or its run has another `header`: the message names the
    first difference.
    """
    if not path.is_file():
        return {}
    try:
        content = json.loads(path.read_text("utf-8"))
        there, solved = content["run"], content["solved"]
        if not (isinstance(there, dict) and isinstance(solved, dict)):
            raise ValueError
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        raise InputError(
            f"{path}: this file does not list the solved trials; give --overwrite to begin anew."
        ) from None
    check_same_header(path, there, header)
    return {str(trial): str(sum_) for trial, sum_ in solved.items()}


def write_solved(path: Path, header: Mapping[str, object], solved: Mapping[str, str]) -> None:
    """Write the digests of the solved trials. Raises `InputError` if the file cannot be written."""
    write_json(path, {"run": header, "solved": solved})
