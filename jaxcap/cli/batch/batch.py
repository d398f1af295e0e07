"""`jaxcap batch`: one verb over many inputs, on the workers of a cluster."""

import contextlib
import os
import shlex
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import tyro

from ...batch.cluster import open_cluster
from ...batch.dask_libraries import import_distributed
from ...batch.mapping import JobResult, map_jobs
from ...batch.size import GIB
from ...batch.versions import installed_version
from ...errors import InputError
from ...io.system.run_lock import run_lock
from ..console.console import pluralise, progress, say, warn
from ..console.errors import error_sentence
from ..console.groups import JAXCAP
from ..console.heartbeat import set_activity
from ..console.options import Flag, OptionalCount, OptionalFile, arg
from ..outputs import check_parent, make_folder
from .finished import (
    check_absent_outputs,
    check_folders,
    index_owners,
    is_finished,
    outputs_of,
    owned_outputs,
)
from .job_lists import ListedJob, list_jobs
from .jobs import Job, make_jobs, value_of
from .memory import job_memory
from .prepare import prepare_worker
from .results import ResultTable, Row, receipts_folder, write_parquet
from .run_job import DONE, FAILED, Assignment, run_job
from .urls import is_url


@dataclass
class Batch:
    """Run a verb over many inputs on the workers of a cluster: by default on all cores of this computer.

    JOBS lists the inputs, and the verb with its options follows after `--`, with the names of JOBS in braces:
    jaxcap batch "takes/{subject}/{take}.c3d" -- markers solve {subject}.npz {input} -o out/{subject}/{take}.bvh

    A job that fails does not stop the others. If a batch was stopped, the same command continues it: jobs that are done
    are known by their options, the contents of their inputs and the version."""

    jobs: tyro.conf.Positional[Annotated[str, arg(metavar="JOBS")]]
    """A quoted pattern of files or folders with named parts, such as "takes/{subject}/{take}.c3d"; or a list of jobs, .toml or
    .csv. The names `input`, `stem` and `folder` are given by every pattern."""
    command: tyro.conf.Positional[
        Annotated[tuple[str, ...], arg(metavar="[-- VERB...]", help_behavior_hint="")]
    ] = ()
    """The verb and its options after `--`. It may be in the list of jobs instead."""
    out: Annotated[OptionalFile, arg(aliases=("-o",), metavar="TABLE")] = None
    """Output file for the table of results, .jsonl. Default: batch.jsonl in the folder of the outputs, or next to the list of
    jobs. If pyarrow is installed, the same table is also written as .parquet."""
    workers: OptionalCount = None
    """Number of worker processes. Default: one for each core, as far as the memory suffices."""
    memory: Annotated[float | None, arg(metavar="GIB", help_behavior_hint="")] = None
    """Memory of each worker, GiB. Default: an estimate of what the verb needs."""
    scheduler: Annotated[str | None, arg(metavar="ADDRESS", help_behavior_hint="")] = None
    """Address of a running Dask scheduler, such as tcp://10.0.0.1:8786, to use its workers."""
    slurm: Annotated[tuple[str, ...], arg(metavar="NAME=VALUE...", help_behavior_hint="")] = ()
    """Start the workers as SLURM jobs, by dask-jobqueue, with options such as partition=cpu time=02:00:00."""
    list: Flag = False
    """Check the jobs, print their commands, and run none."""
    overwrite: Flag = False
    """Do all jobs, also those that are done, and replace their outputs."""

    @staticmethod
    def split_words(words: Sequence[str]) -> tuple[tuple[str, ...], tuple[str, ...]]:
        """Split arguments at `--` into those of the batch and the command of its jobs. Raises `InputError` if it is missing."""
        words = tuple(words)
        if "--" in words:
            end = words.index("--")
            return words[:end], words[end + 1 :]
        verb = next((word for word in words if word in JAXCAP.verbs), None)
        if verb is not None and not {"-h", "--help"} & set(words):
            raise InputError(
                f"`--` is missing before the verb '{verb}'; write `--` between the options of the batch and the verb: "
                f"jaxcap batch JOBS -- {verb} ..."
            )
        return words, ()

    def with_command(self, command: tuple[str, ...]) -> "Batch":
        """Return this batch with the words after `--` as its command. Raises `InputError` if there are others before."""
        others = self.command
        if others and Path(others[0]).exists():
            raise InputError(
                f"{self.jobs} and {others[0]}: JOBS is one pattern, and there are {1 + len(others)} paths; put the pattern into "
                "quotation marks, so that the shell does not replace it by the files."
            )
        if others:
            raise InputError(
                f"'{others[0]}' is not an option of the batch; write the verb and its options after `--`: jaxcap batch JOBS -- "
                "VERB ..."
            )
        return replace(self, command=command)

    def run(self) -> None:
        import_distributed()
        slurm = self.slurm_options()
        if self.memory is not None and not self.memory > 0:
            raise InputError(f"--memory is {self.memory:g}; it must be above 0 GiB.")
        if self.out is not None and self.out.suffix.lower() != ".jsonl":
            raise InputError(
                f"{self.out}: the table of results is written as .jsonl; give -o a name that ends in .jsonl, and write the "
                "output of the jobs after `--` and the verb."
            )
        set_activity("listing the jobs")
        listed = list_jobs(self.jobs, self.command)
        set_activity("checking the options of all jobs")
        jobs = make_jobs(listed)
        if self.list:
            for job in jobs:
                say(f"{job.label}: jaxcap {shlex.join(job.words)}")
            return
        path = self.out or default_table(self.jobs, listed, jobs)
        check_folders(jobs)
        check_parent(path)
        with run_lock(path):
            table = ResultTable(path)
            todo = self.unfinished(jobs, table)
            if todo:
                self.run_jobs(todo, len(jobs), table, slurm)
            report(jobs, table, already=len(jobs) - len(todo))

    def unfinished(self, jobs: Sequence[Job], table: ResultTable) -> Sequence[Job]:
        """List the jobs that are not done. Raises `InputError` if an output exists that is not of this batch."""
        if self.overwrite:
            return jobs
        set_activity("comparing the inputs with those of finished jobs")
        todo = [job for job in jobs if not is_finished(job, table.rows.get(job.key), table.path)]
        check_absent_outputs(todo, table.rows)
        return todo

    def run_jobs(
        self, jobs: Sequence[Job], total: int, table: ResultTable, slurm: dict[str, str] | None
    ) -> None:
        """Run jobs on the cluster, and add their rows to the table as they end."""
        receipts = receipts_folder(table.path)
        make_folder(receipts)
        folder = os.getcwd()
        owners = index_owners(table.rows)
        assignments = [
            Assignment(
                job,
                folder,
                str(receipts.absolute()),
                self.overwrite,
                owned_outputs(job, table.rows, owners),
                outputs_of(table.rows.get(job.key)),
                str(table.path),
            )
            for job in jobs
        ]
        memory = job_memory(job.verb for job in jobs) if self.memory is None else self.memory * GIB
        set_activity("starting the workers")
        opened = open_cluster(
            self.workers, scheduler=self.scheduler, slurm=slurm, memory=memory, jobs=len(jobs)
        )
        begun = total - len(jobs)
        done = begun
        try:
            with opened as client:
                client.register_worker_callbacks(prepare_worker)
                results = map_jobs(run_job, assignments, client)
                rows = rows_of(results, jobs)
                for row in progress(rows, total, begun, "batch", "jobs", first="the first one is done"):
                    if row["status"] == FAILED:
                        # those of an earlier run are still there
                        row["outputs"] = list(outputs_of(table.rows.get(row["key"])))
                    table.append(row)
                    done += row["status"] == DONE
                    if row["status"] == FAILED:
                        warn(_sentence(row))
        except KeyboardInterrupt:
            raise KeyboardInterrupt(
                f"stopped; {done} of {total} jobs are done, and the same command continues"
            ) from None
        # a receipt that is left is read by the next run
        with contextlib.suppress(OSError):
            receipts.rmdir()

    def slurm_options(self) -> dict[str, str] | None:
        """Read the options of SLURM. Raises `InputError`."""
        for word in self.slurm:
            if "=" not in word:
                raise InputError(f"--slurm has '{word}'; give options as NAME=VALUE, such as partition=cpu.")
        return dict(word.split("=", 1) for word in self.slurm) or None


def rows_of(results: Iterator[JobResult], jobs: Sequence[Job]) -> Iterator[Row]:
    """Iterate over the rows of jobs as they end; a job whose worker died has a row, too."""
    for result in results:
        if result.error is None:
            yield result.value
            continue
        job, error = jobs[result.number], result.error
        yield {
            "key": job.key,
            "job": job.label,
            "command": shlex.join(job.words),
            "values": dict(job.values),
            "version": str(installed_version()),
            "status": FAILED,
            "message": error_sentence(error) or f"{type(error).__name__}: {error}",
            "outputs": [],
        }


def report(jobs: Sequence[Job], table: ResultTable, already: int) -> None:
    """Write the table in the order of the jobs and print the counts. Raises `InputError` if jobs failed."""
    table.rewrite(job.key for job in jobs)
    rows = [table.rows[job.key] for job in jobs]
    path = table.path.with_suffix(".parquet")
    written = [str(table.path), *([str(path)] if write_parquet(path, table.rows.values()) else [])]
    failed = [row for row in rows if row["status"] == FAILED]
    before = f", {already} of them before" if already else ""
    verb = "is" if len(rows) == 1 else "are"
    say(
        f"{len(rows) - len(failed)} of {pluralise(len(rows), 'job')} {verb} done{before}: {' and '.join(written)}"
    )
    if failed:
        raise InputError(
            f"{pluralise(len(failed), 'job')} of {len(rows)} failed; correct the inputs and run the same command again. The first: "
            f"{_sentence(failed[0])} The table {table.path} has all messages."
        )


def _sentence(row: Row) -> str:
    """Return the message of a failed job, with the name of the job unless the message has it."""
    return row["message"] if row["job"] in row["message"] else f"{row['job']}: {row['message']}"


def default_table(source: str, listed: Sequence[ListedJob], jobs: Sequence[Job]) -> Path:
    """Choose the table of results: next to a list of jobs, or in the folder that the outputs of a pattern share."""
    if source.lower().endswith((".toml", ".csv")) and Path(source).is_file():
        return Path(source).with_suffix(".results.jsonl")
    outputs = [output for output in jobs[0].outputs() if not is_url(output)]
    for word, filled in zip(listed[0].template, jobs[0].words, strict=True):
        # also in a word such as --out=out/{stem}.bvh
        value = value_of(filled)
        if str(Path(value)) in outputs[:1]:
            folder = word[len(filled) - len(value) :].partition("{")[0].rpartition("/")[0]
            return Path(folder or ".") / "batch.jsonl"
    return Path("batch.jsonl")
