"""The files of a run in chunks: one journal for each task, from which a killed worker's task and a stopped run continue."""

import hashlib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import jax
import numpy as np
from jaxtyping import Float

from ...errors import InputError, user_message
from ...io.archives.journal import Journal, create_journal, read_records, resume_journal
from ...io.lazy_frames import LazyFrames
from ...io.system.run_lock import run_lock
from ...observe.clouds import Cloud
from ...tracking.advance import Search
from ...tracking.chunks.division import name_ranges
from ...tracking.chunks.join_chunks import Outcome
from ...tracking.chunks.segments import AbstractSegment, last_frame
from ...tracking.chunks.tasks import Task, TrackSettings, track_task
from ...tracking.judge_frame import TrackedFrame
from ...tracking.track_frame import Tracker
from ..console.console import warn
from ..console.errors import warnings_as_lines
from ..console.record import record_output
from ..console.timed import timed
from .announce import make_announcer
from .depth import announce_blind, announce_missing
from .frame_records import hash_cloud_name, pack, row_template, row_width, unpack

#: number of rows that are read at once
ROWS = 256


class JournalSegment(AbstractSegment):
    """Frames in the journal of a task; `like` has their shapes and types."""

    def __init__(self, path: Path, first: int, end: int, like: TrackedFrame):
        self.path, self.first, self.end, self.like = path, first, end, like

    def rows(self, first: int, end: int) -> Iterator[Float[np.ndarray, "N R"]]:
        """Iterate over the rows of some frames, in blocks."""
        for begin in range(first, end, ROWS):
            count = min(ROWS, end - begin)
            yield read_records(self.path, begin - self.first, count=count)

    def frames(self, first: int, end: int) -> Iterator[TrackedFrame]:
        for rows in self.rows(first, end):
            yield from (unpack(self.like, row)[0] for row in rows)


@dataclass(frozen=True)
class ChunkedRun:
    """A run as it is sent to the workers."""

    tracker: Tracker
    clouds: LazyFrames[Cloud]
    #: numbers of the frames with a second person, added as the clouds are read
    others: set[int]
    settings: TrackSettings
    #: the folder of the journals
    folder: Path
    #: the settings of the run, which a journal has to have
    header: Mapping[str, object]
    num_cameras: int


@dataclass(frozen=True)
class SavedOutcome:
    """The outcome of a task, and the messages that it printed."""

    outcome: Outcome
    messages: tuple[str, ...]


def run_saved_task(run: ChunkedRun, task: Task) -> SavedOutcome:
    """Track the frames of a task on a worker, and save each one in its journal; continue an interrupted attempt.

    An error ends the task; it is in the outcome, and is not raised.
    """
    with record_output() as record, warnings_as_lines():
        outcome = _run_task(run, task)
    return SavedOutcome(outcome, tuple(record.warnings))


def _run_task(run: ChunkedRun, task: Task) -> Outcome:
    like = row_template(run.tracker, num_cameras=run.num_cameras)
    path, error = run.folder / task.name, ""
    with run_lock(path), _open_journal(run, task, path, row_width(like)) as journal:
        saved = JournalSegment(path, task.first, task.first + journal.count, like)
        left = task._replace(first=saved.end, start=last_frame(saved)) if journal.count else task
        announce = _announcer_of(task)
        clouds = announce_missing(iter(run.clouds[saved.end : task.end]))
        clouds = announce_blind(clouds) if task.is_head else clouds
        try:
            frames = track_task(run.tracker, clouds, left, run.settings, announce)
            for number, (frame, seconds) in enumerate(timed(frames), saved.end):
                frame = replace(frame, others=frame.others or number in run.others)
                journal.append(pack(frame, seconds, run.clouds.names[number]))
        except InputError as reason:
            error = user_message(reason)
        return Outcome(JournalSegment(path, task.first, task.first + journal.count, like), error)


def _announcer_of(task: Task) -> Callable[[Search], None]:
    """Make the function that prints the searches of a task, but for those of frames that are not part of the result."""
    announce = make_announcer()

    def announce_result(search: Search) -> None:
        if search.frame >= task.first + task.warm_up:
            announce(search)

    return announce_result


def _open_journal(run: ChunkedRun, task: Task, path: Path, width: int) -> Journal:
    """Open the journal of an interrupted attempt of the same task, or create one."""
    start = hashlib.sha256()
    for leaf in jax.tree.leaves(task.start):
        start.update(np.asarray(leaf, float).tobytes())
    names = hashlib.sha256()
    for name in run.clouds.names[task.first : task.end]:
        names.update(np.float64(hash_cloud_name(name)).tobytes())
    known = {
        "frames": [task.first, task.end],
        "start": start.hexdigest(),
        "head": task.is_head,
        "clouds": names.hexdigest(),
    }
    header = {**run.header, **known}
    if path.is_file():
        try:
            return resume_journal(path, header, width)
        except InputError:
            # of another start or other clouds, as the sequence has changed
            warn(
                f"frames {name_ranges([(task.first, task.end)])} are tracked again, as what they depend on has changed"
            )
            path.unlink()
    return create_journal(path, header, width)
