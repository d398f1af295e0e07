"""One job on a worker: its verb runs in this process, and its row of the table of results is returned."""

import contextlib
import os
import shlex
import socket
import tempfile
import time
import traceback
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

from ...batch.versions import installed_version
from ...errors import InputError
from ..console.console import warn
from ..console.errors import error_sentence, warnings_as_lines
from ..console.record import Record, record_output
from .figures import collect_figures
from .file_fields import replace_inputs
from .inputs import describe_inputs
from .jobs import Job, with_settings
from .results import read_receipt, write_receipt
from .staging import Staging, empty, open_staging, publish, remove_earlier
from .urls import fetch

#: values of the column `status`
DONE, FAILED = "done", "failed"


class Assignment(NamedTuple):
    """A job as it is sent to a worker."""

    job: Job
    #: the folder from which relative paths count
    folder: str
    #: the folder of receipts, in which a finished job is known before its row arrives
    receipts: str
    #: may all outputs that exist be replaced?
    replace: bool
    #: outputs of earlier runs, which may be replaced in any case
    owned: tuple[str, ...] = ()
    #: outputs of the earlier run of this job, which are removed if they are not written again
    earlier: tuple[str, ...] = ()
    #: the table of results
    table: str = ""


def run_job(assignment: Assignment) -> dict[str, Any]:
    """Run a job; return its row. An error of the job is in the row, and is not raised."""
    job = assignment.job
    _enter(assignment.folder)
    receipt = read_receipt(assignment.receipts, job.key)
    if receipt is not None:
        return receipt
    row = {
        "key": job.key,
        "job": job.label,
        "command": shlex.join(job.words),
        "values": dict(job.values),
        "version": str(installed_version()),
        "worker": f"{socket.gethostname()}:{os.getpid()}",
        "started": round(time.time(), 3),
    }
    start, cpu = time.perf_counter(), time.process_time()
    with record_output() as record, warnings_as_lines():
        found = _run(assignment, record)
    row |= {
        **found,
        "ended": round(time.time(), 3),
        "seconds": round(time.perf_counter() - start, 3),
        "cpu_seconds": round(time.process_time() - cpu, 3),
        "memory_mb": _memory(),
        "messages": record.lines,
        "warnings": record.warnings,
        "rows": record.rows,
    }
    if row["status"] == DONE:
        write_receipt(assignment.receipts, row)
    _forget_compiled()
    return row


def _run(assignment: Assignment, record: Record) -> dict[str, Any]:
    """Run the verb in a folder of its own and publish its outputs; return what the row has of it."""
    job = assignment.job
    try:
        inputs = describe_inputs(job, (assignment.table, *assignment.earlier))
        with open_staging(job) as staging:
            found: dict[str, Any] = {"inputs": inputs, "attempts": staging.attempt}
            try:
                with _local_inputs(job, staging) as command:
                    _run_verb(command, staging)
                found["figures"] = {**record.figures, **collect_figures(staging)}
                replace = assignment.replace or _overwrites(job)
                outputs = publish(staging, replace, (*assignment.owned, *assignment.earlier))
                remove_earlier(assignment.earlier, outputs)
                found |= {"status": DONE, "message": "", "outputs": outputs}
            except _ERRORS as error:
                # the folders remain only for the checkpoints of killed workers: a failed job begins anew
                found |= _failure(error, staging.destination)
            record.lines[:] = map(staging.destination, record.lines)
            record.warnings[:] = map(staging.destination, record.warnings)
            return found
    except _ERRORS as error:
        return {"inputs": {}, "attempts": 1, **_failure(error, str)}


#: all errors of a verb; Dask stops a worker by others
_ERRORS = (Exception, SystemExit)


def _run_verb(command: Any, staging: Staging) -> None:
    """Run a verb; after a killed attempt continue from its checkpoint, or begin anew if that is not possible."""
    if staging.attempt > 1 and hasattr(command, "resume"):
        try:
            with_settings(command, resume=True, overwrite=False).run()
            return
        except InputError as error:
            warn(f"the unfinished attempt cannot be continued and is begun anew: {error}")
    empty(staging)
    with_settings(command, resume=False).run()


def _failure(error: BaseException, destination: Callable[[str], str]) -> dict[str, Any]:
    sentence = error_sentence(error) if isinstance(error, Exception) else str(error)
    found = {"status": FAILED, "outputs": [], "figures": {}}
    if sentence is not None:
        return {**found, "message": destination(sentence)}
    trace = "".join(traceback.format_exception(error))
    return {**found, "message": f"{type(error).__name__}: {error}", "traceback": trace}


def _overwrites(job: Job) -> bool:
    return bool(getattr(job.command, "overwrite", False))


@contextlib.contextmanager
def _local_inputs(job: Job, staging: Staging) -> Iterator[Any]:
    """Load the inputs at URLs for the duration of the block; yield the command that reads their copies."""
    if not job.urls:
        yield staging.command
        return
    with tempfile.TemporaryDirectory(prefix="jaxcap-") as folder:
        copies: dict[str, str] = {}

        def place(text: str) -> str:
            url = job.urls.get(text)
            if url is None:
                return text
            if url not in copies:
                own = Path(folder) / str(len(copies))
                own.mkdir()
                copies[url] = str(fetch(url, own))
            return copies[url]

        yield replace_inputs(job.verb, staging.command, place)


def _enter(folder: str) -> None:
    """Change to the folder of the batch. Raises `InputError` if this computer does not have it."""
    if os.getcwd() != folder:
        try:
            os.chdir(folder)
        except OSError as error:
            raise InputError(
                f"{folder}: the worker on {socket.gethostname()} cannot enter this folder ({error.strerror}); run the batch in a "
                "folder that all workers share, or give URLs and absolute paths."
            ) from None


def _memory() -> int:
    """Measure the memory of this process, in megabytes."""
    import psutil

    return psutil.Process().memory_info().rss >> 20


def _forget_compiled() -> None:
    from ...compiled import forget_many_compiled

    forget_many_compiled()
