"""TRC: tables as Motion Analysis and OpenSim write them, gaps, and what is refused with its line."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import jaxcap as jc
from jaxcap.errors import InputError
from jaxcap.io.markers.marker_file import make_marker_file
from jaxcap.io.registry import read_marker_file

HEAD = (
    "PathFileType\t4\t(X/Y/Z)\twalk.trc\n"
    "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\tOrigDataStartFrame\tOrigNumFrames\n"
    "60.00\t60.00\t3\t2\tmm\t60.00\t1\t3\n"
    "Frame#\tTime\tR.ASIS\t\t\tL.ASIS\t\t\t\n"
    "\t\tX1\tY1\tZ1\tX2\tY2\tZ2\n"
)
ROWS = (
    "7\t0.100\t1000\t2000\t500\t1300\t2000\t501\n"
    "8\t0.117\t1001\t2000\t500\t\t\t\n"
    "9\t0.133\t1002\t2000\t500\t1302\t2000\t503\n"
)
METRES = "7\t0.1\t1\t2\t.5\t1.3\t2\t.501\n8\t.117\t1.001\t2\t.5\n9\t.133\t1.002\t2\t.5\t1.302\t2\t.503\n"


def trc(folder, text):
    (folder / "walk.trc").write_text(text)
    return folder / "walk.trc"


@pytest.mark.parametrize(
    "text",
    [
        HEAD + "\n" + ROWS,
        HEAD + ROWS,
        (HEAD + "\n" + ROWS).replace("\n", "\r\n"),
        HEAD + ROWS.replace("\t\t\t\n", "\n"),
        HEAD + ROWS.replace("\t\t\t\n", "\tNaN\tnan\tNaN\t\n"),
        HEAD + ROWS.replace("\t\t\t\n", "\t0.0\t0\t0.000\n"),
        HEAD.replace("R.ASIS\t\t\t", "R.ASIS\t") + ROWS,
        HEAD.replace("\tmm\t", "\tm\t") + METRES,
        # as spreadsheets save them
        (HEAD + ROWS).replace("\t", ","),
        (HEAD + "\n" + ROWS).replace("\t", ";").replace("0.117", "0,117"),
    ],
)
def test_dialects(tmp_path, text):
    file = read_marker_file(trc(tmp_path, text))
    frames = file.frames
    assert (frames.labels, frames.rate, file.first_frame) == (("R.ASIS", "L.ASIS"), 60.0, 7)
    assert frames.visible.tolist() == [[True, True], [True, False], [True, True]]
    np.testing.assert_allclose(frames.positions[:, 0, 0], [1.0, 1.001, 1.002], rtol=1e-12)
    np.testing.assert_allclose(frames.positions[2, 1], [1.302, 2.0, 0.503], rtol=1e-12)


def test_frames_left_out_are_gaps_and_told(tmp_path):
    file = read_marker_file(trc(tmp_path, HEAD + ROWS.replace("9\t0.133", "11\t0.167")))
    assert file.frames.visible[:, 0].tolist() == [True, True, False, False, True]
    assert "2 frames are missing" in file.warnings[0]


def test_without_a_rate_times_tell_it(tmp_path):
    rows = "".join(f"{i + 1}\t{i / 120:.3f}\t1\t1\t{i}\t400\t1\t1\n" for i in range(200))
    text = HEAD.replace("60.00\t60.00\t3", "0\t0\t200") + rows
    assert jc.read_markers(trc(tmp_path, text)).rate == pytest.approx(120, rel=1e-3)


@given(st.integers(0, 10**6), st.integers(1, 6), st.integers(1, 5), st.sampled_from(["mm", "m", "cm", "in"]))
def test_written_and_read(tmp_path_factory, seed, count, markers, unit):
    rng = np.random.default_rng(seed)
    path = tmp_path_factory.mktemp("trc") / "trial.trc"
    places = rng.normal(size=(count, markers, 3))
    places[rng.random((count, markers)) < 0.4] = np.nan
    places[0, 0] = 0.0, 0.0, 0.0
    frames = jc.make_markers(places, [f"M {i}, of {markers}" for i in range(markers)], 59.94)
    jc.write_markers(path, frames, unit)
    file = read_marker_file(path)
    assert (file.frames.labels, file.frames.rate, file.unit) == (frames.labels, 59.94, unit)
    np.testing.assert_array_equal(file.frames.visible, frames.visible)
    np.testing.assert_allclose(file.frames.positions, frames.positions, rtol=1e-8, atol=2e-9)


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("", "the file is empty"),
        ("hello\nworld\n", ":1: this is not a TRC file"),
        ("\n".join(HEAD.split("\n")[:3]), ":3: the file is cut short within the five lines"),
        (HEAD, "the file has no frames"),
        (HEAD.replace("60.00\t3\t2", "60.00\t0\t2"), "the file has no frames"),
        (HEAD + ROWS[:-10], ":8: marker 'L.ASIS' has 1 of three coordinates"),
        (HEAD + ROWS.replace("1001", "one"), ":7: 'one' in marker R.ASIS is not a number"),
        (HEAD + ROWS.replace("1001", "1e999"), ":7: '1e999' in marker R.ASIS is not finite"),
        (HEAD + ROWS.replace("8\t0", "x\t0"), ":7: 'x' for the frame is not a whole number"),
        (HEAD + ROWS.replace("8\t0", "6\t0"), "the column of frames goes from 7 to 6 in row 2"),
        (
            HEAD + ROWS.replace("\t501", "\t501\t7"),
            ":6: this row, and 0 more, have more cells than 2 markers",
        ),
        (HEAD.replace("3\t2\tmm", "3\t1\tmm") + ROWS, ":4: there are 2 labels for 1 markers"),
        (HEAD.replace("60.00\t3\t2", "60.00\tthree\t2"), ":3: 'three' for NumFrames is not a whole number"),
        (
            HEAD.replace("\tmm\t", "\tm\t") + ROWS.replace("130", "260"),
            "looks like millimetres: pass unit='mm'",
        ),
        (
            "PathFileType\t4\nDataRate\tNumFrames\tNumMarkers\tUnits\n100\t1\t0\tmm\nFrame#\tTime\n\t\n1\t0\n",
            "the file has no markers",
        ),
    ],
)
def test_what_is_refused(tmp_path, text, sentence):
    path = trc(tmp_path, text)
    with pytest.raises(InputError, match=sentence) as error:
        jc.read_markers(path)
    assert str(error.value).startswith(str(path))
    assert "\n" not in str(error.value)


def test_rows_with_further_points_and_wrong_numbers_of_frames_are_read(tmp_path):
    more = HEAD + "".join(f"{row}\t7\t8\t9\n" for row in ROWS.replace("\t\t\t\n", "\t0\t0\t0\n").splitlines())
    file, plain = (read_marker_file(trc(tmp_path, text)) for text in (more, HEAD + ROWS))
    np.testing.assert_array_equal(file.frames.positions, plain.frames.positions)
    assert file.warnings == (
        "3 rows have points beyond the 2 markers of the header, the first in line 6; these points are left out.",
    )
    file = read_marker_file(trc(tmp_path, HEAD + ROWS[: ROWS.index("9\t")]))
    assert len(file.frames) == 2
    assert file.warnings == ("the file has 2 frames; its header declares 3; it may be cut short.",)


def test_a_row_with_shifted_cells_shows_no_marker(tmp_path):
    rows = [f"{i + 1}\t{i / 60:.3f}\t1000\t2000\t{i}\t1300\t2000\t501" for i in range(20)]
    rows[12] = rows[12].replace("\t1300", "\t17\t1300")
    file = read_marker_file(trc(tmp_path, HEAD.replace("60.00\t3\t2", "60.00\t20\t2") + "\n".join(rows)))
    assert np.flatnonzero(~np.asarray(file.frames.visible).all(1)).tolist() == [12]
    assert file.warnings[0].startswith(
        "1 rows have more cells than the 2 markers of the header, in no whole points, in lines 18;"
    )


def test_a_reflection_far_away_is_left_out_of_a_take(tmp_path, rng):
    places = rng.uniform(-0.8, 0.8, (30, 13, 3))
    places[4:, 12] = [30.0, 5.0, 2.0]
    places[:4, 12] = np.nan
    labels = [f"M{i}" for i in range(12)] + ["*13"]
    jc.write_markers(tmp_path / "take.trc", jc.make_markers(places, labels, 100.0))
    with pytest.warns(
        UserWarning, match=r"take.trc: points of '\*13' are more than 5 times .* in frames 4 to 29\."
    ):
        frames = jc.read_markers(tmp_path / "take.trc")
    assert not np.asarray(frames.visible)[:, 12].any() and np.asarray(frames.visible)[:, :12].all()
    # most points are far from each other: this is a wrong unit
    jc.write_markers(tmp_path / "take.trc", jc.make_markers(places[:, :12], labels[:12], 100.0))
    with pytest.raises(InputError, match="this looks like millimetres"):
        jc.read_markers(tmp_path / "take.trc", unit="m")


def test_a_few_positions_without_meaning_are_left_out(rng):
    """As in binary files with numbers that nobody wrote."""
    places = rng.uniform(1.0, 2.0, (20, 2, 3))
    places[3, 1, 2] = 1e30
    file = make_marker_file("take.c3d", places, ["A", "B"], 100.0, "m")
    assert np.argwhere(~np.asarray(file.frames.visible)).tolist() == [[3, 1]]
    assert file.warnings == (
        "1 positions are at 1e15 m or more, the first of 'B', and are left out, in frames 3.",
    )
    with pytest.raises(
        InputError, match="take.c3d: markers are too far away, at 1e15 m or more, in frames 0 to 19"
    ):
        make_marker_file("take.c3d", 1e20 * places, ["A", "B"], 100.0, "m")


def test_what_cannot_be_written(tmp_path):
    frames = jc.make_markers(np.ones((2, 1, 3)), ["a\tb"], 100.0)
    with pytest.raises(InputError, match="contains a tab"):
        jc.write_markers(tmp_path / "walk.trc", frames)
    with pytest.raises(InputError, match="cannot be the unit of a TRC file"):
        jc.write_markers(tmp_path / "walk.trc", jc.make_markers(np.ones((2, 1, 3)), ["a"], 100.0), 0.5)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.shared
def test_a_real_trial_goes_through(shared, tmp_path):
    frames = jc.read_markers(shared / "data" / "markers" / "cmu_02_05.c3d")[:40]
    jc.write_markers(tmp_path / "trial.trc", frames)
    again = jc.read_markers(tmp_path / "trial.trc")
    assert (again.labels, again.rate) == (frames.labels, frames.rate)
    np.testing.assert_allclose(again.positions, frames.positions, rtol=1e-8)
