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
from .staging import begun_outputs
from .urls import exists, folders_of, is_url, place_of

#: keys of jobs by the places of their outputs
Owners = Mapping[str, Collection[str]]


def is_finished(job: Job, row: Row | None, table: Path) -> bool:
    """Test if a job is done by its row of a table: by this version, with these inputs, and its outputs are there."""
    if row is None or row["status"] != DONE or row.get("version") != str(installed_version()):
        return False
    there = (is_url(output) or Path(output).exists() for output in row.get("outputs", ()))
    return all(there) and is_unchanged(job, row.get("inputs", {}), (str(table), *outputs_of(row)))


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
    owners = index_owners(rows)
    for job in jobs:
        if getattr(job.command, "overwrite", False):
            continue
        begun = set(map(place_of, begun_outputs(job)))
        begun.update(folder for place in tuple(begun) for folder in folders_of(place))
        for output in job.outputs():
            place = place_of(output)
            if _is_there(output) and place not in owners and place not in begun:
                raise InputError(
                    f"{output}: this already exists, and it is not an output of an earlier run of this batch; give --overwrite to "
                    "the batch to replace it, or another output."
                )


def owned_outputs(job: Job, rows: Mapping[str, Row], owners: Owners) -> tuple[str, ...]:
    """List the outputs of earlier runs that a job may replace: its own, and those of runs with the same named outputs."""
    keys = dict.fromkeys(
        [job.key, *(key for name in job.outputs() for key in owners.get(place_of(name), ()))]
    )
    return tuple(dict.fromkeys(output for key in keys for output in outputs_of(rows.get(key))))


def outputs_of(row: Row | None) -> tuple[str, ...]:
    """List the outputs that a row says were written; a job that failed after an earlier run has those of that run."""
    return () if row is None else tuple(row.get("outputs", ()))


def index_owners(rows: Mapping[str, Row]) -> Owners:
    """Find the jobs of earlier runs by their outputs and the folders that these are in."""
    owners: dict[str, dict[str, None]] = {}
    for key, row in rows.items():
        for output in outputs_of(row):
            place = place_of(output)
            for each in (place, *folders_of(place)):
                owners.setdefault(each, {})[key] = None
    return owners


def _is_there(output: str) -> bool:
    if is_url(output):
        return exists(output)
    path = Path(output)
    return any(path.iterdir()) if path.is_dir() else path.exists()
