"""The state in which a batch finds its jobs: which are finished, and which outputs belong to it."""

import os
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path

from ...batch.versions import installed_version
from ...errors import InputError
from ..outputs import make_folder
from .inputs import is_unchanged
from .jobs import Job
from .results import Row
from .run_job import DONE
from .staging import is_begun
from .urls import exists, is_url


def is_finished(job: Job, row: Row | None) -> bool:
    """Test if a job is done: by this version, with these inputs, and its outputs are there."""
    if row is None or row["status"] != DONE or row.get("version") != installed_version().number:
        return False
    there = (is_url(output) or Path(output).exists() for output in row.get("outputs", ()))
    return all(there) and is_unchanged(job, row.get("inputs", {}))


def check_folders(jobs: Sequence[Job]) -> None:
    """Make the folders of all outputs, and check that they can be written to. Raises `InputError`."""
    folders = {Path(output).parent for job in jobs for output in job.outputs() if not is_url(output)}
    for folder in sorted(folders):
        make_folder(folder)
        if not os.access(folder, os.W_OK | os.X_OK):
            raise InputError(
                f"{folder}: this folder cannot be written to (Permission denied); give another one."
            )


def check_absent_outputs(jobs: Sequence[Job], rows: Mapping[str, Row]) -> None:
    """Check that no output exists, except those of earlier runs of this batch. Raises `InputError`."""
    owned = _owned(rows)
    for job in jobs:
        if getattr(job.command, "overwrite", False) or job.key in rows or is_begun(job):
            continue
        for output in job.outputs():
            if _is_there(output) and os.path.normpath(output) not in owned:
                raise InputError(
                    f"{output}: this already exists, and it is not an output of an earlier run of this batch; give --overwrite to "
                    "the batch to replace it, or another output."
                )


def owns_outputs(job: Job, rows: Mapping[str, Row]) -> bool:
    """Test if outputs that exist are those of an earlier run; named outputs were checked to be that."""
    return job.key in rows or any(map(_is_there, job.outputs()))


def _owned(rows: Mapping[str, Row]) -> Collection[str]:
    """Collect the outputs of earlier runs, and the folders that they are in."""
    found: set[str] = set()
    for row in rows.values():
        for output in row.get("outputs", ()):
            path = Path(os.path.normpath(output))
            found.update((str(path), str(path.parent)))
    return found


def _is_there(output: str) -> bool:
    if is_url(output):
        return exists(output)
    path = Path(output)
    return any(path.iterdir()) if path.is_dir() else path.exists()
