"""The trials of a run that have their results, in one file that is replaced as a whole after each of them."""

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path

from ...errors import InputError
from ...io.archives.journal import check_same_run
from ...io.table import write_json


def digest(path: str | Path) -> str:
    """The SHA-256 of a file. Raises `InputError` where it cannot be read."""
    try:
        return hashlib.sha256(Path(path).read_bytes()).hexdigest()
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); check the path.") from None


def read_solved(path: Path, header: Mapping[str, object]) -> dict[str, str]:
    """Read the digests of the trials that are solved, by their paths; none where the file is not there.

    **Raises:** `InputError` where it is no such file, or its run was begun with another `header`: the first difference is
    named.
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
            f"{path}: this file does not say which trials are solved; give --overwrite to begin anew."
        ) from None
    check_same_run(path, there, header)
    return {str(trial): str(sum_) for trial, sum_ in solved.items()}


def write_solved(path: Path, header: Mapping[str, object], solved: Mapping[str, str]) -> None:
    """Write the digests of the trials that are solved. Raises `InputError` where the file cannot be written."""
    write_json(path, {"run": header, "solved": solved})
