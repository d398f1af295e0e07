"""`jaxcap markers info`: what it says of a file, its picture, and what it refuses."""

import numpy as np
import pytest
from c3d_bytes import c3d_bytes
from command_line import fails, runs
from matplotlib.image import imread

import jaxcap as jc
from jaxcap.cli import main
from jaxcap.cli.markers.info import time_bar


@pytest.fixture
def trial(tmp_path):
    rng = np.random.default_rng(0)
    places = 300 + 1200 * rng.random((1, 5, 3)) + 30 * rng.random((200, 5, 3))
    residuals = np.zeros((200, 5))
    residuals[100:150, 1] = residuals[10:12, 3] = residuals[20:22, 3] = -1
    labels = ["Anna:LKNE", "Anna:RKNE", "Anna:LKneeAngles", "Anna:LANK", "*32"]
    (tmp_path / "trial.c3d").write_bytes(c3d_bytes(places, labels, residuals=residuals, first=37))
    return tmp_path / "trial.c3d"


def test_what_is_told(capsys, trial):
    told = runs(capsys, "markers", "info", trial)
    assert "200 frames at 100 frames per second, 2.00 s, the first frame is 37" in told
    assert "markers: 4 (1 without a label), unit mm, all frames 1" in told
    assert "subject: Anna, 3 markers" in told
    assert "angles: 1 (Anna:LKneeAngles)" in told
    lines = told.splitlines()
    (head,) = [i for i, line in enumerate(lines) if line.startswith("marker ")]
    # the worst first
    assert lines[head + 1].split()[:6] == ["RKNE", "75.00", "%", "1", "0.5", "s"]
    assert lines[head + 2].split()[:6] == ["LANK", "98.00", "%", "2", "0.02", "s"]
    assert lines[head + 1].endswith(20 * "█" + 10 * " " + 10 * "█")
    short = runs(capsys, "markers", "info", trial, "--rows", 1)
    assert "... and 1 more; --rows 0 shows all" in short
    assert "LANK" not in short


def test_a_bar_hides_no_gap():
    seen = np.ones(10000, bool)
    seen[5000] = False
    assert time_bar(seen).count("█") == 39
    assert time_bar(~seen).count(" ") == 39
    assert time_bar(np.ones(3, bool)) == "███".ljust(40)


def test_the_picture_is_dark_where_seen(capsys, trial, tmp_path):
    runs(capsys, "markers", "info", trial, "--picture", tmp_path / "gaps.png")
    picture = imread(tmp_path / "gaps.png")[..., :3]
    again = ("markers", "info", trial, "--picture", tmp_path / "gaps.png")
    assert "give --overwrite" in fails(capsys, *again)
    runs(capsys, *again, "--overwrite")
    dark = picture.mean(2) < 0.35
    rows = np.flatnonzero(dark.mean(1) > 0.5)
    # the second of four rows is light between a half and three quarters
    row = dark[rows[int(0.375 * len(rows))]]
    # without the label, which is narrower than any run of a second of four
    edges = np.flatnonzero(np.diff(np.concatenate([[0], row.astype(int), [0]]))).reshape(-1, 2)
    (begin, pause), (again, end) = edges[np.diff(edges)[:, 0] > 0.1 * len(row)]
    assert (pause - begin) / (end - begin) == pytest.approx(0.5, abs=0.01)
    assert (again - begin) / (end - begin) == pytest.approx(0.75, abs=0.01)


def test_what_is_wrong_is_told_beside(capsys, trial, tmp_path):
    frames = jc.read_markers(trial)
    still = jc.MarkerFrames(
        np.repeat(frames.positions[:1], 5, 0), np.ones((5, 4), bool), frames.labels, 100.0
    )
    jc.write_markers(tmp_path / "still.trc", still)
    capsys.readouterr()
    main(["markers", "info", str(tmp_path / "still.trc"), "--unit", "m"])
    told = capsys.readouterr()
    assert "gaps: none, every marker is seen in every frame" in told.out
    assert "All 5 frames are equal" in told.err
    assert "looks like millimetres" in told.err


def test_several_subjects_are_told(capsys, tmp_path):
    places = np.random.default_rng(0).random((5, 4, 3)) * 1500 + 1
    (tmp_path / "two.c3d").write_bytes(c3d_bytes(places, ["Anna:A", "Ben:A", "Ben:B", "Ben:C"]))
    told = runs(capsys, "markers", "info", tmp_path / "two.c3d")
    assert "subject: Anna, 1 markers" in told
    assert "subject: Ben, 3 markers" in told
    assert "markers: 3," in runs(capsys, "markers", "info", tmp_path / "two.c3d", "--subject", "Ben")
    assert "no subject 'Carl'" in fails(capsys, "markers", "info", tmp_path / "two.c3d", "--subject", "Carl")


def test_what_is_refused(capsys, trial, tmp_path):
    assert "no such file" in fails(capsys, "markers", "info", tmp_path / "none.c3d")
    (tmp_path / "some.bvh").touch()
    assert "expected a marker file: .c3d, .trc, .csv" in fails(
        capsys, "markers", "info", tmp_path / "some.bvh"
    )
    assert "ends in .png" in fails(capsys, "markers", "info", trial, "--picture", tmp_path / "gaps.jpg")
    assert "not a unit" in fails(capsys, "markers", "info", trial, "--unit", "yards")
    assert "--rows -1" in fails(capsys, "markers", "info", trial, "--rows", "-1")
    trial.write_bytes(trial.read_bytes()[:4096])
    assert "cut short" in fails(capsys, "markers", "info", trial)


@pytest.mark.parametrize("words", [["markers", "--help"], ["markers", "info", "--help"]])
def test_help(capsys, words):
    with pytest.raises(SystemExit) as stop:
        main(words)
    assert not stop.value.code
    assert "info" in capsys.readouterr().out


@pytest.mark.shared
def test_a_real_file(capsys, shared):
    told = runs(capsys, "markers", "info", shared / "data" / "markers" / "cmu_02_05.c3d")
    assert "1854 frames at 120 frames per second, 15.45 s" in told
    assert "subject: TakeoMonday, 41 markers" in told
    assert "RSHN    99.84 %     1  0.025 s" in told
