"""`jaxcap track`: what it writes, what it refuses, and that a stopped run goes on to the same end."""

import csv
import dataclasses
import json
import os
import signal
import subprocess
import time

import equinox as eqx
import numpy as np
import pytest
from command_line import FRAMES, PYTHON, fails, runs, write_inputs

from jaxcap.body.kinematics import forward_kinematics, joint_positions
from jaxcap.cli import main
from jaxcap.cli.sources import load_body
from jaxcap.cli.track import person_shape
from jaxcap.cli.track import track as track_module
from jaxcap.io.archives.journal import Journal
from jaxcap.io.archives.npz import load_motion, load_skeleton
from jaxcap.io.meshes.mesh import Mesh, write_mesh
from jaxcap.io.skeletons.bvh import read_bvh
from jaxcap.tracking.advance import Search
from jaxcap.tracking.track import track_frames


@pytest.fixture(scope="module")
def inputs(tmp_path_factory):
    return write_inputs(tmp_path_factory.mktemp("inputs"))


@pytest.fixture(scope="module")
def finished(inputs):
    """A run from beginning to end."""
    track_module.Track(
        body=str(inputs / "body.npz"), clouds=(str(inputs / "clouds.npz"),), out=inputs / "whole"
    ).run()
    return inputs / "whole"


def command(inputs, out, *more):
    return ["track", inputs / "body.npz", inputs / "clouds.npz", "-o", out, *more]


def same_motion(a, b) -> bool:
    with np.load(a / "motion.npz") as first, np.load(b / "motion.npz") as second:
        assert set(first.files) == set(second.files)
        arrays = all(np.array_equal(first[name], second[name]) for name in first.files)
    return arrays and (a / "motion.bvh").read_bytes() == (b / "motion.bvh").read_bytes()


def stop_after(monkeypatch, frames: int) -> None:
    """Ctrl-C when so many frames are in the journal."""
    append = Journal.append

    def stopping(self, record):
        if stopping.left == 0:
            raise KeyboardInterrupt
        stopping.left -= 1
        append(self, record)

    stopping.left = frames
    monkeypatch.setattr(Journal, "append", stopping)


def test_results_follow_the_truth(inputs, finished):
    motion, truth = (load_motion(folder) for folder in (finished / "motion.npz", inputs / "truth.npz"))
    skeleton = load_skeleton(finished / "motion.npz")
    assert motion.num_frames == FRAMES
    errors = [
        np.linalg.norm(
            joint_positions(skeleton, forward_kinematics(skeleton, motion[frame]))
            - joint_positions(skeleton, forward_kinematics(skeleton, truth[frame])),
            axis=1,
        ).mean()
        for frame in range(FRAMES)
    ]
    assert max(errors) < 0.02


def test_bvh_and_npz_hold_the_same_motion(finished):
    skeleton, motion = read_bvh(finished / "motion.bvh")
    own, saved = load_skeleton(finished / "motion.npz"), load_motion(finished / "motion.npz")
    assert motion.num_frames == saved.num_frames
    shared = [name for name in own.names if name in skeleton.names]
    assert len(shared) == 31
    for frame in (0, FRAMES - 1):
        here = joint_positions(own, forward_kinematics(own, saved[frame]))
        there = joint_positions(skeleton, forward_kinematics(skeleton, motion[frame]))
        for name in shared:
            np.testing.assert_allclose(there[skeleton.index(name)], here[own.index(name)], atol=1e-4)


def test_statistics_of_every_frame(finished):
    with open(finished / "statistics.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    report = json.loads((finished / "statistics.json").read_text())
    assert len(rows) == len(report["frames"]) == FRAMES
    for number, (row, same) in enumerate(zip(rows, report["frames"], strict=True)):
        assert int(row["frame"]) == number
        assert row["cloud"] == f"clouds.npz[{number}]"
        assert row["verdict"] == "good"
        for name in ("energy", "sigma", "outlier_share", "mean_distance", "seconds"):
            assert float(row[name]) == same[name]
        assert 0.0 <= same["outlier_share"] < 0.3
        # points are some millimetres off a surface whose vertices are centimetres apart
        assert 0.001 < same["mean_distance"] < 0.05


def test_frames_are_chosen(inputs, tmp_path, capsys):
    runs(capsys, *command(inputs, tmp_path / "out", "--first", 1, "--last", 3))
    assert load_motion(tmp_path / "out" / "motion.npz").num_frames == 3


def test_files_as_a_shell_makes_of_a_glob(inputs, tmp_path, capsys):
    """Not in the order of their numbers; track and evaluate take them as the quoted glob."""
    with np.load(inputs / "clouds.npz") as file:
        for number, (points, normals) in enumerate(zip(file["points"], file["normals"], strict=True), 8):
            write_mesh(tmp_path / f"c_{number}.ply", Mesh(points, np.zeros((0, 3), int), normals))
    body, quoted, files = inputs / "body.npz", tmp_path / "*.ply", sorted(tmp_path.glob("*.ply"))
    assert files[0].name == "c_10.ply"
    some = ("--initialise", "never", "--last", 3)
    runs(capsys, "track", body, quoted, "-o", tmp_path / "quoted", *some)
    runs(capsys, "track", body, *files, "-o", tmp_path / "files", *some)
    assert same_motion(tmp_path / "files", tmp_path / "quoted")
    with open(tmp_path / "files" / "statistics.csv", newline="") as file:
        assert [row["cloud"] for row in csv.DictReader(file)] == [f"c_{n}.ply" for n in range(8, 12)]
    told = [
        runs(capsys, "evaluate", body, tmp_path / "files" / "motion.npz", *clouds, "--last", 3)
        for clouds in ((quoted,), files)
    ]
    assert told[0] == told[1]
    line = fails(capsys, "track", body, *files, inputs / "clouds.npz", "-o", tmp_path / "none")
    assert "clouds.npz: an .npz contains a whole sequence" in line
    assert "No clouds were given" in fails(capsys, "track", body, "-o", tmp_path / "none")


def test_finished_results_are_not_replaced_unasked(inputs, finished, capsys):
    before = {path.name: path.read_bytes() for path in finished.iterdir()}
    line = fails(capsys, *command(inputs, finished))
    assert "--overwrite" in line
    assert "--resume" in line
    assert {path.name: path.read_bytes() for path in finished.iterdir()} == before


def test_resuming_a_finished_run_changes_nothing(inputs, finished, capsys):
    before = {path.name: path.read_bytes() for path in finished.iterdir()}
    runs(capsys, *command(inputs, finished, "--resume"))
    after = {path.name: path.read_bytes() for path in finished.iterdir()}
    # archives carry the time at which they were written
    assert before.pop("motion.npz")
    assert after.pop("motion.npz")
    assert after == before


def test_stopped_run_tells_writes_and_goes_on(inputs, finished, tmp_path, capsys, monkeypatch):
    out = tmp_path / "out"
    with monkeypatch.context() as patch:
        stop_after(patch, 3)
        line = fails(capsys, *command(inputs, out), code=130)
    assert f"3 of {FRAMES} frames" in line
    assert load_motion(out / "motion.npz").num_frames == 3
    runs(capsys, *command(inputs, out, "--resume"))
    assert same_motion(out, finished)


def test_the_shape_of_a_person_is_written_and_used_again(inputs, finished, tmp_path, capsys, monkeypatch):
    """The body of a stopped run is that of its continuation, and is not estimated twice."""
    out, given = tmp_path / "out", []

    def estimate(tracker, clouds, model):
        given.append(len(clouds))
        return eqx.tree_at(lambda b: b.vertices, tracker.body, 1.001 * tracker.body.vertices)

    monkeypatch.setattr(person_shape, "estimate_shape", estimate)
    with monkeypatch.context() as patch:
        stop_after(patch, 2)
        fails(capsys, *command(inputs, out, "--fit-shape"), code=130)
    runs(capsys, *command(inputs, out, "--fit-shape", "--resume"))
    assert given == [FRAMES]
    before, after = (load_body(str(path))[0] for path in (inputs / "body.npz", out / "person.npz"))
    np.testing.assert_allclose(after.vertices, 1.001 * before.vertices, atol=1e-6)
    assert load_motion(out / "motion.npz").num_frames == FRAMES
    assert not same_motion(out, finished)
    # without the option it is another run
    assert "fit_shape" in fails(capsys, *command(inputs, out, "--resume"))


def test_torn_record_is_done_again(inputs, finished, tmp_path, capsys, monkeypatch):
    out = tmp_path / "out"
    with monkeypatch.context() as patch:
        stop_after(patch, 4)
        fails(capsys, *command(inputs, out), code=130)
    for name in ("motion.bvh", "motion.npz", "statistics.csv", "statistics.json"):
        (out / name).unlink()
    with open(out / "journal", "r+b") as file:
        file.truncate(os.path.getsize(out / "journal") - 11)
    assert "unfinished run" in fails(capsys, *command(inputs, out))
    runs(capsys, *command(inputs, out, "--resume"))
    assert same_motion(out, finished)


def test_run_goes_on_with_more_frames(inputs, finished, tmp_path, capsys):
    """A finished run of the first frames, when more have come."""
    out = tmp_path / "out"
    runs(capsys, *command(inputs, out, "--last", 1))
    assert load_motion(out / "motion.npz").num_frames == 2
    runs(capsys, *command(inputs, out, "--resume"))
    assert same_motion(out, finished)


def test_clouds_put_between_are_not_mixed_with_what_was_solved(inputs, tmp_path, capsys, monkeypatch):
    """The first cloud is the same, and the second is now another one."""
    with np.load(inputs / "clouds.npz") as file:
        for name, points, normals in zip("aceb", file["points"], file["normals"], strict=False):
            write_mesh(tmp_path / f"{name}.ply", Mesh(points, np.zeros((0, 3), int), normals))
    os.replace(tmp_path / "b.ply", tmp_path / "later")

    def run(*more):
        return ["track", inputs / "body.npz", tmp_path / "*.ply", "-o", tmp_path / "out", *more]

    with monkeypatch.context() as patch:
        stop_after(patch, 2)
        fails(capsys, *run(), code=130)
    os.replace(tmp_path / "later", tmp_path / "b.ply")
    assert "frame 1 of this run was not b.ply" in fails(capsys, *run("--resume"))
    os.replace(tmp_path / "b.ply", tmp_path / "f.ply")
    runs(capsys, *run("--resume"))
    with open(tmp_path / "out" / "statistics.csv", newline="") as file:
        assert [row["cloud"] for row in csv.DictReader(file)] == ["a.ply", "c.ply", "e.ply", "f.ply"]


def test_stop_before_the_first_frame_leaves_nothing(inputs, tmp_path, capsys, monkeypatch):
    stop_after(monkeypatch, 0)
    fails(capsys, *command(inputs, tmp_path / "out"), code=130)
    assert list((tmp_path / "out").iterdir()) == []


def test_resume_with_other_settings_is_refused(inputs, finished, capsys):
    line = fails(capsys, *command(inputs, finished, "--resume", "--sigma0", "0.2"))
    assert "sigma0" in line
    assert "0.1" in line
    assert "0.2" in line


def test_resume_with_another_body_is_refused(inputs, finished, tmp_path, capsys):
    with np.load(inputs / "body.npz") as file:
        arrays = dict(file)
    arrays["vertices"] = arrays["vertices"] * 1.01
    np.savez(tmp_path / "body.npz", **arrays)
    line = fails(capsys, "track", tmp_path / "body.npz", inputs / "clouds.npz", "-o", finished, "--resume")
    assert "body" in line


@pytest.mark.parametrize(
    ("option", "value"),
    [
        ("--sigma0", "0"),
        ("--outlier", "1"),
        ("--normal-angle", "190"),
        ("--iterations", "0"),
        ("--rate", "nan"),
    ],
)
def test_options_out_of_range(inputs, tmp_path, capsys, option, value):
    assert option in fails(capsys, *command(inputs, tmp_path / "out", option, value))
    assert not (tmp_path / "out").exists()


def test_other_axis_up_gives_the_same_motion(inputs, finished, tmp_path, capsys):
    with np.load(inputs / "clouds.npz") as file:
        # y up to z up: (x, y, z) -> (x, -z, y)
        turned = {name: file[name][..., [0, 2, 1]] * [1, -1, 1] for name in file.files}
    np.savez(tmp_path / "clouds.npz", **turned)
    runs(capsys, "track", inputs / "body.npz", tmp_path / "clouds.npz", "-o", tmp_path / "out", "--up", "z")
    here, there = (load_motion(folder / "motion.npz").poses for folder in (tmp_path / "out", finished))
    np.testing.assert_allclose(here.rotations, there.rotations, atol=1e-6)
    np.testing.assert_allclose(here.translations, there.translations, atol=1e-6)


def test_lost_frames_are_told(inputs, tmp_path, capsys, monkeypatch):
    def losing(*arguments, **options):
        for number, frame in enumerate(track_frames(*arguments, **options)):
            yield dataclasses.replace(frame, lost=number in (1, 3))

    monkeypatch.setattr(track_module, "track_frames", losing)
    main([str(word) for word in command(inputs, tmp_path / "out")])
    assert f"2 of {FRAMES} frames are lost: 1, 3" in capsys.readouterr().err
    rows = json.loads((tmp_path / "out" / "statistics.json").read_text())["frames"]
    assert [row["verdict"] for row in rows] == ["good", "lost", "good", "lost", "good"]


def test_a_body_that_is_in_no_frame_is_an_error(inputs, tmp_path, capsys, monkeypatch):
    """What was found is written all the same."""

    def losing(*arguments, **options):
        for frame in track_frames(*arguments, **options):
            yield dataclasses.replace(frame, lost=True)

    monkeypatch.setattr(track_module, "track_frames", losing)
    monkeypatch.setattr(track_module, "advise", lambda *_, **__: None)
    with pytest.raises(SystemExit) as stop:
        main([str(word) for word in command(inputs, tmp_path / "out")])
    assert stop.value.code == 2
    assert f"found in none of the {FRAMES} frames" in capsys.readouterr().err
    with pytest.warns(UserWarning, match=f"{FRAMES} of {FRAMES} frames are lost"):
        assert len(load_motion(tmp_path / "out" / "motion.npz")) == FRAMES


def test_a_search_is_announced_with_its_reason(capsys):
    announce = track_module.make_announcer()
    announce(Search(3, ("unexplained points near the left leg",), 0))
    announce(Search(9, ("missing points on the left arm",), 1))
    first, second = capsys.readouterr().err.splitlines()
    assert "frame 3: unexplained points near the left leg" in first and "compiles" in first
    assert (
        "frame 9: missing points on the left arm; 1 search before it" in second and "compiles" not in second
    )


def test_wrong_cloud_on_the_way_keeps_the_frames_before(inputs, finished, tmp_path, capsys):
    with np.load(inputs / "clouds.npz") as file:
        arrays = {name: file[name] for name in file.files}
    sound = arrays["points"][3, 5, 0]
    arrays["points"][3, 5, 0] = np.nan
    clouds, out = tmp_path / "clouds.npz", tmp_path / "out"
    np.savez(clouds, **arrays)
    line = fails(capsys, "track", inputs / "body.npz", clouds, "-o", out)
    assert "clouds.npz[3]" in line
    assert "3 previous frames are kept" in line
    assert {path.name for path in out.iterdir()} == {"journal"}
    arrays["points"][3, 5, 0] = sound
    np.savez(clouds, **arrays)
    runs(capsys, "track", inputs / "body.npz", clouds, "-o", out, "--resume")
    assert same_motion(out, finished)


@pytest.mark.slow
def test_killed_run_goes_on_to_the_same_result(inputs, tmp_path):
    """The same through real processes, one of them killed without warning, in float32."""
    program = [PYTHON, "-c", "import sys; from jaxcap.cli import main; main(sys.argv[1:])"]
    words = [str(word) for word in command(inputs, "")]
    environment = {**os.environ, "JAX_COMPILATION_CACHE_DIR": str(tmp_path / "cache")}

    def start(folder, *more):
        words[4] = str(folder)
        return subprocess.Popen([*program, *words, *more], env=environment, stderr=subprocess.DEVNULL)

    assert start(tmp_path / "whole").wait(300) == 0
    killed = start(tmp_path / "out")
    journal, limit = tmp_path / "out" / "journal", time.monotonic() + 300
    whole = os.path.getsize(tmp_path / "whole" / "journal")
    # the header of both is of one length, about 1 kB; wait for a record or two
    while not (journal.is_file() and os.path.getsize(journal) > 0.4 * whole):
        assert time.monotonic() < limit
        assert killed.poll() is None, "the run ended before it could be killed"
        time.sleep(0.001)
    killed.send_signal(signal.SIGKILL)
    killed.wait(60)
    assert not (tmp_path / "out" / "motion.bvh").exists()
    assert start(tmp_path / "out", "--resume").wait(300) == 0
    assert same_motion(tmp_path / "out", tmp_path / "whole")
