"""Joint angles as CSV, read by NumPy and pandas."""

import numpy as np
import pytest

import jaxcap as jc
from jaxcap.io.angle_table import read_angle_names

SKELETON = jc.human(resolution="low").skeleton
ANGLES = jc.joint_angles(SKELETON, jc.Motion(jc.body.sample_poses(SKELETON, count=4), 50.0))


def test_numpy_reads_times_and_degrees(tmp_path):
    path = tmp_path / "angles.csv"
    jc.io.write_angles(path, ANGLES)
    lines = path.read_text().splitlines()
    head = [line for line in lines if line.startswith("#")]
    assert len(head) == 2 + len(ANGLES.names)
    assert lines[len(head)] == ",".join(("time", *ANGLES.names))
    assert "degrees" in head[1]
    said = next(line for line in head if line.startswith("# knee_angle_l: "))
    for word in ("femur_l to tibia_l", "Z-X-Y", "positive: flexion", "Grood and Suntay 1983"):
        assert word in said
    table = np.loadtxt(path, delimiter=",", comments="#", skiprows=len(head) + 1)
    np.testing.assert_allclose(table[:, 0], np.arange(4) / 50, atol=1e-9)
    np.testing.assert_allclose(table[:, 1:], np.degrees(ANGLES.values), atol=1e-6)


def test_pandas_reads_the_columns(tmp_path):
    pandas = pytest.importorskip("pandas")
    jc.io.write_angles(tmp_path / "angles.csv", ANGLES.to_degrees())
    table = pandas.read_csv(tmp_path / "angles.csv", comment="#")
    assert tuple(table.columns) == ("time", *ANGLES.names)
    np.testing.assert_allclose(table["hip_flexion_r"], np.degrees(ANGLES["hip_flexion_r"]), atol=1e-6)


def test_what_cannot_be_written_is_refused(tmp_path):
    with pytest.raises(jc.InputError, match="joint angles are not written as '.xlsx' files; use .csv"):
        jc.io.write_angles(tmp_path / "angles.xlsx", ANGLES)
    with pytest.raises(jc.InputError, match="poses without a rate"):
        jc.io.write_angles(tmp_path / "angles.csv", jc.joint_angles(SKELETON, jc.rest_pose(SKELETON)))
    assert not list(tmp_path.iterdir())


def test_names_of_no_file_are_refused(tmp_path):
    with pytest.raises(jc.InputError, match="there is no such file"):
        read_angle_names(tmp_path / "none.csv")
    with pytest.raises(jc.InputError, match="cannot be read"):
        read_angle_names(tmp_path)


def test_a_table_of_opensim_has_the_same_angles_and_may_begin_later(tmp_path):
    jc.io.write_angles(tmp_path / "angles.mot", ANGLES, start=1.5)
    read = jc.io.read_storage(tmp_path / "angles.mot")
    assert (read.names, read.in_degrees, read.start, read.title) == (ANGLES.names, True, 1.5, "Joint angles")
    np.testing.assert_allclose(read.values, np.asarray(ANGLES.to_degrees().values), rtol=1e-8, atol=1e-8)
    jc.io.write_angles(tmp_path / "angles.csv", ANGLES, 1.5)
    times = np.loadtxt(
        tmp_path / "angles.csv", delimiter=",", skiprows=0, comments="#", usecols=0, converters=_number
    )
    assert np.nanmin(times) == 1.5


def _number(word):
    return float("nan") if word == "time" else float(word)
