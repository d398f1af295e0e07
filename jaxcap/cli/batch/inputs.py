"""The inputs of a job as they were when it ran: a job is done again if they change."""

import glob
import hashlib
import itertools
import os
import re
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

from .file_fields import input_values
from .jobs import Job
from .urls import folders_of, is_url, place_of, stamp

_NUMBER = re.compile(r"%0?\d*d")
_WILDCARD = re.compile(r"[*?\[%]")


def describe_inputs(
    job: Job, left_out: Sequence[str] = (), with_contents: bool = True
) -> dict[str, dict[str, Any]]:
    """Describe the inputs that a command names, by their names: files, folders, patterns and URLs that exist.

    Of folders and patterns, hidden files, the outputs that the job names, and those `left_out` are no inputs.

    Each has the number of its `files`, a `stamp`, which is a hash of names, sizes and times, and with contents a hash of them
    (`sha256`). URLs have a stamp only.
    """
    described = {}
    outputs = {place_of(output) for output in (*job.outputs(), *left_out) if output}
    outputs |= {os.path.splitext(place)[0] + ".parquet" for place in outputs if place.endswith(".jsonl")}
    for value in dict.fromkeys(input_values(job.verb, job.command)):
        url = job.urls.get(value, value)
        if is_url(url):
            described[url] = {"files": 1, "stamp": stamp(url)}
            continue
        files = _files_of(value, outputs)
        if files:
            described[value] = {"files": len(files), "stamp": _stamp(files)}
            if with_contents:
                described[value]["sha256"] = _contents(files)
    return described


def is_unchanged(job: Job, recorded: Mapping[str, Mapping[str, Any]], left_out: Sequence[str] = ()) -> bool:
    """Test if the inputs of a job are those of its record: by sizes and times, and only if these differ by their contents."""
    now = describe_inputs(job, left_out, with_contents=False)
    if set(now) != set(recorded):
        return False
    differing = [name for name in now if now[name]["stamp"] != recorded[name].get("stamp")]
    if not differing:
        return True
    full = describe_inputs(job, left_out)
    return all(full[name].get("sha256", "") == recorded[name].get("sha256") for name in differing)


def _files_of(value: str, outputs: Collection[str]) -> list[Path]:
    """List the files that a value names: one file, a folder's, or those of a pattern; of these, without outputs."""
    if not value or len(value) > 4096 or "\0" in value:
        return []
    path = Path(value)
    # a clip of a file, as in `character.glb:Walk`
    for candidate in (path, Path(value.rpartition(":")[0] or value)):
        if candidate.is_file():
            return [candidate]
    if path.is_dir():
        files = (file for file in path.rglob("*") if file.is_file() and not _is_hidden(file, path))
        return sorted(file for file in files if not _is_output(file, path, outputs))
    if glob.has_magic(value) or _NUMBER.search(value):
        found = glob.glob(_NUMBER.sub("*", value), recursive=True)
        folder = Path(_WILDCARD.split(value)[0] + "*").parent
        files = (Path(name) for name in found if os.path.isfile(name))
        return sorted(file for file in files if not _is_output(file, folder, outputs))
    return []


def _is_output(file: Path, folder: Path, outputs: Collection[str]) -> bool:
    """Test if a file below a folder is an output, or in an output folder that is below the same folder."""
    place, top = place_of(str(file)), place_of(str(folder))
    below = itertools.takewhile(lambda each: each != top, folders_of(place))
    return any(each in outputs for each in (place, *below))


def _is_hidden(file: Path, folder: Path) -> bool:
    return any(part.startswith(".") for part in file.relative_to(folder).parts)


def _stamp(files: list[Path]) -> str:
    digest = hashlib.sha256()
    for file in files:
        found = file.stat()
        digest.update(f"{file} {found.st_size} {found.st_mtime_ns}\n".encode())
    return digest.hexdigest()


def _contents(files: list[Path]) -> str:
    digest = hashlib.sha256()
    for file in files:
        digest.update(f"{file.name}\n".encode())
        with open(file, "rb") as opened:
            digest.update(hashlib.file_digest(opened, "sha256").digest())
    return digest.hexdigest()
