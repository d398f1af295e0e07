"""Markers in CSV: heads of several kinds, rates from times, gaps, and what is refused with its line."""

import csv

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import jaxcap as jc
from jaxcap.errors import InputError
from jaxcap.io.markers.marker_table import read_marker_table

ROWS = "0.00,1,2,.5,1.3,2,.5\n0.01,1.001,2,.5,,,\n0.02,1.002,2,.5,1.302,2,.5\n"


def table(folder, text):
    (folder / "walk.csv").write_text(text)
    return folder / "walk.csv"


@pytest.mark.parametrize(
    "text",
    [
        "time,A.x,A.y,A.z,B.x,B.y,B.z\n" + ROWS,
        "Time (s),A_X,A_Y,A_Z,B_X,B_Y,B_Z\n" + ROWS,
        "t,A x,A y,A z,B x,B y,B z\n" + ROWS,
        "time,A:X (m),A:Y (m),A:Z (m),B:X (m),B:Y (m),B:Z (m)\n" + ROWS,
        "Time,A,,,B,,\n,X,Y,Z,X,Y,Z\n" + ROWS,
        "Time,A,A,A,B,B,B\ns,x,y,z,x,y,z\n" + ROWS,
        ",A,,,B,,\ntime,X1,Y1,Z1,X2,Y2,Z2\n" + ROWS,
        "# of a trial\n\ntime,A.x,A.y,A.z,B.x,B.y,B.z\r\n" + ROWS.replace("\n", "\r\n"),
        ("time,A.x,A.y,A.z,B.x,B.y,B.z\n" + ROWS).replace(",", ";"),
        ("time,A.x,A.y,A.z,B.x,B.y,B.z\n" + ROWS.replace(",,,", ",NaN,nan,NaN")).replace(",", "\t"),
        "time_ms,A.x,A.y,A.z,B.x,B.y,B.z\n" + ROWS.replace("0.01,", "10,", 1).replace("0.02,", "20,"),
        "# rate: 100\nframe,A.x,A.y,A.z,B.x,B.y,B.z\n" + ROWS.replace("0.00,", "1,").replace("0.01,", "2,")
        .replace("0.02,", "3,"),
        "time,quality,A.z,A.x,A.y,B.z,B.x,B.y\n0,9,.5,1,2,.5,1.3,2\n0.01,9,.5,1.001,2,0,0,0\n0.02,9,.5,1.002,2,.5,1.302,2\n",
    ],
)  # fmt: skip
def test_dialects(tmp_path, text):
    frames = jc.read_markers(table(tmp_path, text))
    assert (frames.labels, frames.rate) == (("A", "B"), 100.0)
    assert frames.visible.tolist() == [[True, True], [True, False], [True, True]]
    expected = [
        [[1, 2, 0.5], [1.3, 2, 0.5]],
        [[1.001, 2, 0.5], [0, 0, 0]],
        [[1.002, 2, 0.5], [1.302, 2, 0.5]],
    ]
    np.testing.assert_allclose(frames.positions, expected)


def test_unit_and_rate_are_the_callers(tmp_path):
    text = "A.x,A.y,A.z,B.x,B.y,B.z\n100,200,50,130,200,50\n101,200,50,131,200,50\n"
    with pytest.raises(InputError, match="the frame rate is unknown"):
        jc.read_markers(table(tmp_path, text))
    file = read_marker_table(table(tmp_path, text), unit="cm", rate=50.0)
    assert file.frames.rate == 50.0
    np.testing.assert_allclose(file.frames.positions[0, 0], [1.0, 2.0, 0.5])
    with pytest.raises(InputError, match="looks like centimetres: pass unit='cm'"):
        jc.read_markers(table(tmp_path, "# rate: 50\n" + text.replace("130", "300")))


def test_times_of_few_digits_and_rows_left_out(tmp_path):
    kept = [i for i in range(300) if i not in (40, 41, 200)]
    rows = "".join(f"{i / 120:.3f},1,2,{i},3,3,3\n" for i in kept)
    file = read_marker_table(table(tmp_path, "time,A.x,A.y,A.z,B.x,B.y,B.z\n" + rows))
    assert file.frames.rate == pytest.approx(120, rel=2e-4)
    assert np.flatnonzero(~np.asarray(file.frames.visible[:, 0])).tolist() == [40, 41, 200]
    np.testing.assert_array_equal(file.frames.positions[kept, 0, 2], kept)
    assert "3 frames are missing" in file.warnings[0]


@given(
    st.integers(0, 10**6),
    st.integers(1, 6),
    st.sampled_from([["A"], ["a,b", 'c"d', "x"], ["A.x", "A_y", "time", "*32"], ["Ä ß", "1"]]),
    st.sampled_from(["m", "mm", "in"]),
    st.sampled_from([120.0, 59.94, 29.97, 1000 / 3]),
)
def test_written_and_read(tmp_path_factory, seed, count, labels, unit, rate):
    rng = np.random.default_rng(seed)
    path = tmp_path_factory.mktemp("csv") / "trial.csv"
    places = rng.normal(size=(count, len(labels), 3))
    places[rng.random((count, len(labels))) < 0.4] = np.nan
    places[0, 0] = 0.0, 0.0, 0.0
    frames = jc.make_markers(places, labels, rate)
    jc.write_markers(path, frames, unit)
    again = read_marker_table(path, unit).frames
    assert (again.labels, again.rate) == (tuple(labels), pytest.approx(rate, rel=1e-8))
    np.testing.assert_array_equal(again.visible, frames.visible)
    np.testing.assert_allclose(again.positions, frames.positions, rtol=1e-8, atol=2e-9)
    if count > 1:
        with path.open(newline="", encoding="utf-8") as file:
            times = [float(row["time"]) for row in csv.DictReader(file)]
        np.testing.assert_allclose(times, np.arange(count) / rate, rtol=1e-9)


HEAD = "time,A.x,A.y,A.z,B.x,B.y,B.z\n"


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("", "the table is empty"),
        ("# rate: 100\n", "the table is empty"),
        ("time,speed\n0,1\n", ":1: the table has no columns of markers; name them as in 'LKNE.x'"),
        (HEAD, "the file has no frames"),
        (HEAD.replace(",B.z", "") + "0,1,2,3,4,5\n", ":1: marker 'B' has no column 'B.z'"),
        (HEAD.replace("B", "A") + ROWS, ":1: two columns are named 'A.x'"),
        (HEAD + ROWS.replace("1.001", "one"), ":3: 'one' in marker A is not a number"),
        (HEAD + ROWS.replace("1.001", "inf"), ":3: 'inf' in marker A is not finite"),
        (HEAD + ROWS.replace("1.001", ""), ":3: marker 'A' has 2 of three coordinates"),
        (HEAD + ROWS[:-8], r":4: this row has 5 cells for 7 columns; it is damaged or cut short"),
        (
            HEAD + ROWS.replace("0.02", "0.01"),
            "column 'time' goes from 0.01 to 0.01 in row 3; expected increasing values",
        ),
        (HEAD + ROWS.replace("0.02", "0.0281"), "column 'time' has unequal steps"),
        (HEAD + ROWS.replace("0.02", ""), ":4: '' in column 'time' is not a number"),
        (HEAD + "0,,,,,,\n0.01,,,,,,\n", "none of its 2 markers is visible in any of 2 frames"),
        ("# rate: -5\n" + HEAD.replace("time", "note") + ROWS, "the rate is -5.0 frames per second"),
        ("time,P:A.x,P:A.y,P:A.z,Q:B.x,Q:B.y,Q:B.z\n" + ROWS, "2 subjects, 'P' .* and 'Q'"),
        ("\0\1\2", "this is a binary file"),
    ],
)
def test_what_is_refused(tmp_path, text, sentence):
    path = table(tmp_path, text)
    with pytest.raises(InputError, match=sentence) as error:
        jc.read_markers(path)
    assert str(error.value).startswith(str(path))
    assert "\n" not in str(error.value)
