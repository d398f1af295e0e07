"""`jaxcap track --workers`: one long sequence in chunks on the workers of a cluster."""

import contextlib
import json
import shutil
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ...batch.cluster import open_cluster
from ...batch.mapping import map_jobs
from ...errors import InputError
from ...io.archives.journal import Journal, count_records
from ...io.table import write_json
from ...tracking.chunks.agreement import is_unsure
from ...tracking.chunks.division import Chunk, count_chunks, divide_frames, name_ranges
from ...tracking.chunks.join_chunks import Boundary, JoinedChunks, Outcome, join_chunks
from ...tracking.chunks.tasks import Task
from ...tracking.chunks.track_chunks import count_workers, outcome_of
from ...tracking.judge_frame import TrackedFrame
from ...tracking.track import name_frames
from ..batch.memory import job_memory
from ..batch.prepare import prepare_worker
from ..console.console import has_terminal, pluralise, progress_bar, report_progress, say, warn
from ..console.heartbeat import set_activity
from .chunk_files import ChunkedRun, JournalSegment, SavedOutcome, run_saved_task
from .frame_records import judgements_of, row_template

#: the file of the division, in the folder of the journals
PLAN = "plan.json"
#: seconds between two looks at the number of tracked frames, and between two lines without a terminal
LOOK_SECONDS, LINE_SECONDS = 1.0, 5.0


class ChunkOptions(NamedTuple):
    """The options of a run in chunks."""

    workers: int | None
    scheduler: str | None
    chunks: int | None
    overlap: int


def track_in_chunks(run: ChunkedRun, options: ChunkOptions, journal: Journal, report: Path) -> None:
    """Track all frames that the journal lacks in chunks, add them to it, and write the boundaries of the chunks to `report`.

    **Raises:** `InputError` if frames could not be tracked. All others are kept in the folder of the run, for --resume.
    """
    count, plan = len(run.clouds), run.folder / PLAN
    if journal.count >= count and not plan.is_file():
        return
    run.folder.mkdir(exist_ok=True)
    set_activity("starting the workers")
    memory = job_memory(["track"])
    opened = open_cluster(options.workers, scheduler=options.scheduler, memory=memory, jobs=count)
    try:
        with opened as client:
            client.register_worker_callbacks(prepare_worker)
            workers = count_workers(client)
            chunks = find_division(plan, count, workers, options, journal.count)
            first = chunks[0].first
            say(f"{pluralise(len(chunks), 'chunk')} on {pluralise(workers, 'worker')}")
            with watch_frames(run.folder, first, count):
                joined = join_chunks(
                    run.tracker.body.skeleton,
                    chunks,
                    partial(_run, client, run),
                    _frame_before(run, journal, first),
                    run.settings.tolerance,
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
    unsure = _add_rows(run, chunks, joined, journal)
    write_report(report, joined.boundaries, unsure, run.settings.tolerance, options.overlap)
    shutil.rmtree(run.folder)
    _describe(joined.boundaries, unsure)


def find_division(path: Path, count: int, workers: int, options: ChunkOptions, num_done: int) -> list[Chunk]:
    """Divide the frames from `num_done` on into chunks, and write the division to a file; a stopped run of as many frames has its own."""
    with contextlib.suppress(OSError, ValueError, TypeError, KeyError):
        stored = json.loads(path.read_text())
        chunks = [Chunk(*map(int, chunk)) for chunk in stored["chunks"]]
        # some rows may have been joined when it was stopped
        if chunks[-1].end == count and chunks[0].first <= num_done:
            return chunks
    left = count - num_done
    number = options.chunks or count_chunks(left, workers, options.overlap)
    divided = divide_frames(left, number, options.overlap, num_done)
    write_json(path, {"chunks": [list(chunk) for chunk in divided]})
    return divided


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


def _add_rows(run: ChunkedRun, chunks: Sequence[Chunk], joined: JoinedChunks, journal: Journal) -> list[int]:
    """Add the rows of all chunks to the journal of the run; return the frames whose verdict could be another one in one run."""
    unsure: list[int] = []
    for chunk, segment, boundary in zip(chunks, joined.chunks, (None, *joined.boundaries), strict=True):
        assert segment is not None
        for span in segment.between(chunk.begin, chunk.end).spans:
            assert isinstance(span.segment, JournalSegment)
            number = span.first
            for rows in span.segment.rows(span.first, span.end):
                if boundary is not None:
                    close = is_unsure(judgements_of(span.segment.like, rows), boundary.margin)
                    numbers = (number + np.flatnonzero(close)).tolist()
                    unsure += [k for k in numbers if k >= boundary.frame + boundary.num_repeated]
                # rows that a stopped run has joined are there
                for row in rows[max(journal.count - number, 0) :]:
                    journal.append(row)
                number += len(rows)
    return unsure


def write_report(
    path: Path, boundaries: Sequence[Boundary], unsure: Sequence[int], tolerance: float, overlap: int
) -> None:
    """Write how the chunks were joined: distances in metres, frames counted from 0."""
    rows = [boundary._asdict() for boundary in boundaries]
    write_json(path, {"tolerance": tolerance, "overlap": overlap, "boundaries": rows, "unsure": list(unsure)})


def _describe(boundaries: Sequence[Boundary], unsure: Sequence[int]) -> None:
    """Print how the chunks were joined."""
    for boundary in boundaries:
        if boundary.num_repeated:
            end = boundary.frame + boundary.num_repeated
            say(
                f"frames {name_ranges([(boundary.frame, end)])} were tracked again from the frame before, as two chunks did not agree there"
            )
    if unsure:
        warn(
            f"the verdict of {pluralise(len(unsure), 'frame')} is near a limit, and could be another one in one run, and with it "
            f"the poses of some frames from there on: {name_frames(unsure)}, counted from 0"
        )


@contextlib.contextmanager
def watch_frames(folder: Path, first: int, count: int) -> Iterator[None]:
    """Report the number of tracked frames in a folder of journals during a block."""
    stop = threading.Event()

    def watch(move: Callable[..., None]) -> None:
        start, printed, begun = time.monotonic(), time.monotonic(), None
        while not stop.wait(LOOK_SECONDS):
            done = min(_count_frames(folder), count - first)
            begun = done if begun is None else begun
            rate = (done - begun) / (time.monotonic() - start)
            move(first + done, f"{rate:.1f} frames/s")
            if not has_terminal() and time.monotonic() - printed > LINE_SECONDS:
                report_progress(f"tracking: {first + done} of {count} frames, {rate:.1f} frames/s")
                printed = time.monotonic()

    shown = (
        progress_bar("tracking", count, first) if has_terminal() else contextlib.nullcontext(lambda *_: None)
    )
    with shown as move:
        thread = threading.Thread(target=watch, args=(move,), daemon=True, name="tracked frames")
        thread.start()
        try:
            yield
        finally:
            stop.set()
            thread.join()


def _count_frames(folder: Path) -> int:
    """Count the frames in the journals of a folder."""
    found = 0
    for path in folder.iterdir():
        with contextlib.suppress(InputError, OSError):
            found += count_records(path) if path.name != PLAN else 0
    return found
