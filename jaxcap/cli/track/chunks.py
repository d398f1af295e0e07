"""`jaxcap track --workers`: one long sequence in chunks on the workers of a cluster."""

import contextlib
import json
import shutil
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ...batch.cluster import open_cluster
from ...batch.mapping import map_jobs
from ...errors import InputError
from ...io.archives.journal import Journal, count_records
from ...io.table import write_json
from ...tracking.chunks.division import WARM_UP, Chunk, count_chunks, divide_frames, name_ranges
from ...tracking.chunks.join_chunks import REPEATED, Boundary, Outcome, join_chunks
from ...tracking.chunks.segments import Span
from ...tracking.chunks.tasks import Task
from ...tracking.chunks.track_chunks import outcome_of
from ...tracking.judge_frame import TrackedFrame
from ..batch.memory import job_memory
from ..batch.prepare import prepare_worker
from ..console.console import has_terminal, pluralise, progress_bar, report_progress, say, warn
from ..console.heartbeat import set_activity
from .chunk_files import ChunkedRun, JournalSegment, SavedOutcome, run_saved_task
from .frame_records import row_template

#: the file of the division, in the folder of the journals
PLAN = "plan.json"
#: seconds between two looks at the number of tracked frames, and between two lines without a terminal
LOOK_SECONDS, LINE_SECONDS = 1.0, 5.0


class ChunkOptions(NamedTuple):
    """The options of a run in chunks."""

    workers: int | None
    scheduler: str | None
    chunks: int | None


def track_in_chunks(run: ChunkedRun, options: ChunkOptions, journal: Journal, report: Path) -> None:
    """Track all frames that the journal lacks in chunks, add them to it, and write the boundaries of the chunks to `report`.

    **Raises:** `InputError` if frames could not be tracked. All others are kept in the folder of the run, for --resume.
    """
    count, plan = len(run.clouds), run.folder / PLAN
    if journal.count >= count and not _stored_division(plan, count, journal.count):
        return
    set_activity("starting the workers")
    memory = job_memory(["track"])
    run.folder.mkdir(exist_ok=True)
    chunks = find_division(plan, count, options, journal.count)
    # with one thread each, so that the poses do not depend on the number of workers
    opened = open_cluster(
        options.workers, scheduler=options.scheduler, memory=memory, jobs=len(chunks), threads=1
    )
    try:
        with opened as client:
            client.register_worker_callbacks(prepare_worker)
            threads: Any = client.nthreads()
            workers = max(len(threads), 1)
            say(f"{pluralise(len(chunks), 'chunk')} on {pluralise(workers, 'worker')}")
            with watch_frames(run.folder, chunks):
                joined = join_chunks(
                    run.tracker,
                    chunks,
                    partial(_run, client, run),
                    _frame_before(run, journal, chunks[0].begin),
                )
    except KeyboardInterrupt:
        raise KeyboardInterrupt(
            "stopped; the tracked frames of all chunks are kept, and --resume continues"
        ) from None
    if joined.failures:
        lines = "; ".join(
            f"frames {name_ranges([(failed.first, failed.end)])}: {failed.message}"
            for failed in joined.failures
        )
        raise InputError(
            f"{lines} The frames of all other chunks are kept; correct the input and give --resume to continue."
        )
    set_activity("joining the chunks")
    _add_rows(joined.spans, journal)
    write_json(report, {"boundaries": [boundary._asdict() for boundary in joined.boundaries]})
    shutil.rmtree(run.folder)
    _describe(joined.boundaries)


def find_division(path: Path, count: int, options: ChunkOptions, num_done: int) -> list[Chunk]:
    """Divide the frames from `num_done` on into chunks, and write the division to a file; continue that of a stopped run.

    If the sequence has become longer or shorter since, chunks that are still in it stay, and others are added.
    """
    chunks = _stored_division(path, count, num_done)
    begin = chunks[-1].end if chunks else num_done
    if begin == count:
        return chunks
    left = count - begin
    chosen = None if chunks else options.chunks
    number = chosen or count_chunks(left)
    # what is left of a stopped run may be short
    most = max(left // WARM_UP, 1) if begin else number
    chunks += divide_frames(left, min(number, most), begin)
    write_json(path, {"chunks": [list(chunk) for chunk in chunks]})
    return chunks


def _stored_division(path: Path, count: int, num_done: int) -> list[Chunk]:
    """Read the chunks of a stopped run that end within `count` frames; none if they do not follow those that are done."""
    with contextlib.suppress(OSError, ValueError, TypeError, KeyError):
        stored = json.loads(path.read_text())
        chunks = [Chunk(*map(int, chunk)) for chunk in stored["chunks"]]
        # some rows may have been joined when it was stopped
        if chunks[0].begin <= num_done:
            return [chunk for chunk in chunks if chunk.end <= count]
    return []


def _frame_before(run: ChunkedRun, journal: Journal, number: int) -> TrackedFrame | None:
    """Read the frame before the first one of a run in chunks; None at the beginning of the sequence."""
    if not number:
        return None
    like = row_template(run.tracker, num_cameras=run.num_cameras)
    return next(JournalSegment(journal.path, 0, journal.count, like).frames(number - 1, number))


def _run(client, run: ChunkedRun, tasks: Sequence[Task]) -> Iterator[tuple[int, Outcome]]:
    """Run tasks on the workers; print their messages."""
    for result in map_jobs(partial(run_saved_task, run), tasks, client):
        if isinstance(result.value, SavedOutcome):
            for message in result.value.messages:
                warn(message)
            result = result._replace(value=result.value.outcome)
        yield result.number, outcome_of(result)


def _add_rows(spans: Sequence[Span], journal: Journal) -> None:
    """Add the rows of all frames to the journal of the run."""
    for span in spans:
        assert isinstance(span.segment, JournalSegment)
        # rows that a stopped run has added are there
        for rows in span.segment.rows(max(span.first, journal.count), span.end):
            for row in rows:
                journal.append(row)


def _describe(boundaries: Sequence[Boundary]) -> None:
    """Print how the chunks were joined."""
    for boundary in boundaries:
        if boundary.num_repeated and not np.isnan(boundary.distance):
            frames = name_ranges([(boundary.frame, boundary.frame + boundary.num_repeated)])
            warn(
                f"before frame {boundary.frame} two chunks have poses that differ by {boundary.distance:.2f} m at a joint, and both look "
                f"right; frames {frames} continue the earlier chunk: check them"
            )


@contextlib.contextmanager
def watch_frames(folder: Path, chunks: Sequence[Chunk]) -> Iterator[None]:
    """Report the number of tracked frames in a folder of journals during a block: those of all chunks, and those before each."""
    stop, count = threading.Event(), chunks[-1].end - chunks[0].begin + WARM_UP * (len(chunks) - 1)

    def watch(move: Callable[..., None]) -> None:
        start, printed, begun = time.monotonic(), time.monotonic(), None
        while not stop.wait(LOOK_SECONDS):
            repeated = _count_frames(folder, f"{REPEATED}*")
            done = _count_frames(folder) - repeated
            begun = done + repeated if begun is None else begun
            text = f"{(done + repeated - begun) / (time.monotonic() - start):.1f} frames/s"
            if repeated:
                text += f", {pluralise(repeated, 'frame')} tracked again"
            move(min(done, count), text)
            if not has_terminal() and time.monotonic() - printed > LINE_SECONDS:
                report_progress(f"tracking: {min(done, count)} of {count} frames of all chunks, {text}")
                printed = time.monotonic()

    shown = progress_bar("tracking", count, 0) if has_terminal() else contextlib.nullcontext(lambda *_: None)
    with shown as move:
        thread = threading.Thread(target=watch, args=(move,), daemon=True, name="tracked frames")
        thread.start()
        try:
            yield
        finally:
            stop.set()
            thread.join()


def _count_frames(folder: Path, pattern: str = "*") -> int:
    """Count the frames in the journals of a folder."""
    found = 0
    for path in folder.glob(pattern):
        with contextlib.suppress(InputError, OSError):
            found += count_records(path) if path.name != PLAN else 0
    return found
