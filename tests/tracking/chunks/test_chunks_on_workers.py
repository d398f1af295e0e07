"""Chunks on the workers of a cluster, and their files."""

import json
import subprocess

import jax
import numpy as np
import pytest
from command_line import PYTHON
from limb_scene import BODY, TRACKER, joints, pose_of, scan_frames

from jaxcap.batch.cluster import open_cluster
from jaxcap.cli.track import chunk_files
from jaxcap.cli.track.chunk_files import ChunkedRun, JournalSegment, run_saved_task
from jaxcap.cli.track.chunks import ChunkOptions, _add_rows, find_division
from jaxcap.cli.track.frame_records import CLOUD_AT, hash_cloud_name, row_width
from jaxcap.cli.track.track import Track
from jaxcap.errors import InputError
from jaxcap.io.archives.journal import Journal, create_journal
from jaxcap.io.archives.npz import load_motion, save_body
from jaxcap.io.lazy_frames import LazyFrames
from jaxcap.io.meshes.mesh import Mesh, write_mesh
from jaxcap.tracking.chunks.division import Chunk
from jaxcap.tracking.chunks.segments import Span
from jaxcap.tracking.chunks.tasks import Task, TrackSettings
from jaxcap.tracking.chunks.track_chunks import track_chunks
from jaxcap.tracking.track import track_frames

pytest.importorskip("distributed")
FRAMES = 70
PROGRAM = "import sys; from jaxcap.cli import main; main(sys.argv[1:])"
STOP_WHILE_JOINING = """
from jaxcap.io.archives.journal import Journal, create_journal
append, left = Journal.append, [10]
def stopped(self, record):
    if not left[0]:
        raise KeyboardInterrupt
    left[0] -= 1
    append(self, record)
Journal.append = stopped
"""


def run_program(*words, before="") -> tuple[int, str]:
    """Run the command line in a process of its own; return its exit code and output."""
    command = [PYTHON, "-c", f"{before}\n{PROGRAM}", *map(str, words)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=900)
    return done.returncode, done.stdout + done.stderr


@pytest.fixture(scope="module")
def clouds():
    return scan_frames(FRAMES)


@pytest.fixture(scope="module")
def alone(clouds):
    return list(track_frames(TRACKER, clouds, pose_of(0), planes=[]))


def test_workers_track_nearly_the_poses_without_chunks(clouds, alone):
    with open_cluster(2, processes=False) as client:
        found = track_chunks(TRACKER, clouds, pose_of(0), client=client, chunks=2, planes=[])
    assert not found.failures
    assert [boundary.independent for boundary in found.boundaries] == [True]
    for number, (frame, one) in enumerate(zip(found.frames, alone, strict=True)):
        assert frame is not None
        # the second chunk begins anew
        assert np.abs(joints(frame.pose) - joints(one.pose)).max() <= (0 if number < 35 else 5e-3)
        assert frame.verdict == one.verdict


def test_wrong_arguments_are_refused_before_a_cluster_is_started(clouds):
    with pytest.raises(InputError, match="number of chunks is 0"):
        track_chunks(TRACKER, clouds, chunks=0)
    with pytest.raises(InputError, match="give fewer chunks"):
        track_chunks(TRACKER, clouds, chunks=50)


def saved_run(folder, clouds):
    names = [f"{number}.ply" for number in range(FRAMES)]
    lazy = LazyFrames(names, lambda number: clouds[number])
    return ChunkedRun(TRACKER, lazy, {3}, TrackSettings(), folder, {"body": "limb"}, 0)


def test_an_interrupted_task_continues_from_its_journal(clouds, alone, tmp_path, monkeypatch):
    run, task = saved_run(tmp_path, clouds), Task("chunk_0", 0, 12, pose_of(0))
    append, left = Journal.append, [5]

    def dying(self, record):
        if not left[0]:
            raise KeyboardInterrupt
        left[0] -= 1
        append(self, record)

    monkeypatch.setattr(Journal, "append", dying)
    with pytest.raises(KeyboardInterrupt):
        run_saved_task(run, task)
    left[0], begun = -1, []
    follow = chunk_files.track_task

    def counted(*arguments):
        for frame in follow(*arguments):
            begun.append(frame)
            yield frame

    monkeypatch.setattr(chunk_files, "track_task", counted)
    segment = run_saved_task(run, task).outcome.segment
    assert isinstance(segment, JournalSegment)
    assert len(begun) == 7
    frames = list(segment.frames(0, 12))
    # a second person, which the reader of the clouds noticed
    assert [number for number, frame in enumerate(frames) if frame.others] == [3]
    for frame, one in zip(frames, alone[:12], strict=True):
        assert all(map(np.array_equal, jax.tree.leaves(frame.pose), jax.tree.leaves(one.pose)))
    # a finished task is not tracked again, and one from another start is begun anew
    begun.clear()
    run_saved_task(run, task)
    assert begun == []
    run_saved_task(run, task._replace(start=pose_of(1)))
    assert len(begun) == 12


def test_the_head_ends_with_its_baseline_also_after_an_interruption(clouds, tmp_path):
    run = saved_run(tmp_path, clouds)
    for _ in range(2):
        segment = run_saved_task(run, Task("head", 0, FRAMES, pose_of(0), is_head=True)).outcome.segment
        assert segment is not None and segment.end == 30


def test_a_cloud_that_cannot_be_read_ends_a_task_with_its_sentence(clouds, tmp_path):
    def load(number):
        if number == 4:
            raise InputError("4.ply: damaged.")
        return clouds[number]

    run = saved_run(tmp_path, clouds)
    run = ChunkedRun(**{**vars(run), "clouds": LazyFrames(run.clouds.names, load)})
    outcome = run_saved_task(run, Task("chunk_0", 0, 12, pose_of(0))).outcome
    assert outcome.error == "4.ply: damaged."
    assert outcome.segment is not None and outcome.segment.end == 4


def test_rows_are_joined_in_order_also_after_an_interruption(clouds, alone, tmp_path):
    run = saved_run(tmp_path, clouds)
    first = run_saved_task(run, Task("chunk_0", 0, 12, pose_of(0))).outcome.segment
    second = run_saved_task(run, Task("chunk_1", 8, 20, alone[7], 4)).outcome.segment
    with create_journal(tmp_path / "journal", {}, row_width(first.like)) as journal:
        # a run that was stopped after three rows
        for row in next(first.rows(0, 3)):
            journal.append(row)
        _add_rows([Span(0, 12, first), Span(12, 20, second)], journal)
        rows = journal.read()
    assert len(rows) == 20
    names = [hash_cloud_name(f"{number}.ply") for number in range(20)]
    assert rows[:, CLOUD_AT].tolist() == names


def test_a_stopped_run_keeps_its_division(tmp_path):
    path = tmp_path / "plan.json"
    first = find_division(path, 100, ChunkOptions(None, None, 3), 0)
    # also while its rows were being joined
    assert find_division(path, 100, ChunkOptions(None, None, 5), 40) == first
    # clouds were added, and removed
    longer = find_division(path, 150, ChunkOptions(None, None, None), 0)
    assert longer == [*first, Chunk(100, 150)]
    assert find_division(path, 90, ChunkOptions(None, None, None), 0) == [*first[:2], Chunk(67, 90)]
    # what is left is shorter than the given number of chunks allows
    other = find_division(tmp_path / "other.json", 30, ChunkOptions(None, None, 5), 10)
    assert other == [Chunk(10, 20), Chunk(20, 30)]


def test_a_journal_of_other_clouds_is_not_used(clouds, tmp_path, capsys):
    run, task = saved_run(tmp_path, clouds), Task("chunk_0", 0, 3, pose_of(0))
    run_saved_task(run, task)
    names = ["0.ply", "2.ply", "3.ply"]
    other = ChunkedRun(**{**vars(run), "clouds": LazyFrames(names, lambda k: clouds[(0, 2, 3)[k]])})
    saved = run_saved_task(other, task)
    assert "frames 0 to 2 are tracked again" in saved.messages[0]
    rows = next(saved.outcome.segment.rows(0, 3))
    assert rows[:, CLOUD_AT].tolist() == [hash_cloud_name(name) for name in names]
    assert run_saved_task(other, task).messages == ()


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"chunks": 3}, "--chunks is for several workers"),
        ({"workers": 2, "scheduler": "tcp://there:1"}, "give one of them"),
        ({"workers": 2, "people": "2"}, "for one person"),
        ({"workers": 0}, "--workers is 0"),
    ],
)
def test_options_of_chunks_are_checked(options, words, tmp_path):
    with pytest.raises(InputError, match=words):
        Track(body="human", clouds=("a.ply",), out=tmp_path / "out", **options).run()
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_the_command_tracks_in_chunks_and_continues(clouds, tmp_path):
    """The program is stopped while the chunks are joined; the result is that of one run."""
    save_body(tmp_path / "limb.npz", BODY)
    for number, cloud in enumerate(clouds):
        real = np.asarray(cloud.weights) > 0
        points, normals = np.asarray(cloud.points)[real], np.asarray(cloud.normals)[real]
        write_mesh(tmp_path / f"cloud_{number:03d}.ply", Mesh(points, np.zeros((0, 3), int), normals))
    words = ["track", tmp_path / "limb.npz", tmp_path / "cloud_*.ply", "--chunks", "2", "-o"]
    assert run_program(*words, tmp_path / "one", "--workers", "1")[0] == 0
    two = (*words, tmp_path / "two", "--workers", "2")
    assert run_program(*two, before=STOP_WHILE_JOINING)[0] == 130
    code, out = run_program(*two, "--resume")
    assert code == 0
    assert "2 chunks on 2 workers" in out
    first, second = (load_motion(tmp_path / name / "motion.npz") for name in ("one", "two"))
    assert first.num_frames == second.num_frames == FRAMES
    for number in range(FRAMES):
        assert np.array_equal(joints(first[number]), joints(second[number]))
    report = json.loads((tmp_path / "two" / "chunks.json").read_text())
    assert [boundary["joined"] for boundary in report["boundaries"]] == [True]
    assert not (tmp_path / "two" / "chunks").exists()
