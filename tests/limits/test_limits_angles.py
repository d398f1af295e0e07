"""Limits from tables of joint angles: conventions, units, MATLAB files, and tables that are refused."""

import zlib

import numpy as np
import pytest
from limits_legs import HUMAN, leg_motion
from scipy.io import savemat
from scipy.spatial.transform import Rotation

import jaxcap as jc
from jaxcap.io.opensim.storage import write_storage


@pytest.mark.parametrize("suffix", [".csv", ".mot", ".mat"])
def test_a_table_of_angles_gives_the_limits_of_its_motion(tmp_path, suffix):
    motion = leg_motion(4)
    angles = jc.joint_angles(HUMAN, motion)
    path = tmp_path / f"angles{suffix}"
    if suffix == ".mat":
        columns = {name: np.asarray(angles[name]) for name in angles.names}
        savemat(path, {"angles": columns, "time": np.arange(len(motion)) / 30.0})
        read = jc.io.read_angles(path, "isb-radians")
    else:
        jc.io.write_angles(path, angles)
        read = jc.io.read_angles(path)
    assert read.rate == pytest.approx(30.0, rel=1e-4)
    samples = jc.biomechanics.gather_angle_samples([read], "knee_l", "hip_l")
    limits = jc.limits.learn_limits(
        {"hip_l": samples.parent, "knee_l": samples}, voxel=np.radians(10), keyframe=np.radians(20)
    )
    here = jc.limits.transfer_limits(limits, HUMAN, jc.biomechanics.find_anatomical_joints(HUMAN))
    assert [(each.joint, each.parent) for each in here.surfaces] == [
        ("LeftUpLeg", None),
        ("LeftLeg", "LeftUpLeg"),
    ]
    assert jc.limits.allowed_frames(here, HUMAN, motion).all()
    wild = leg_motion(9, size=2.5)
    assert not jc.limits.allowed_frames(here, HUMAN, wild).all()


def test_tables_without_a_convention_or_with_another_unit_are_refused(tmp_path):
    path = tmp_path / "knee.csv"
    path.write_text("time,knee_angle_r\n0,0.1\n0.1,1.2\n0.2,0.4\n")
    with pytest.raises(
        jc.InputError, match="does not state the convention of its angles; give --convention isb"
    ):
        jc.io.read_angles(path)
    with pytest.raises(jc.InputError, match="looks like radians; give .* isb-radians, or .* isb-degrees if"):
        jc.io.read_angles(path, "isb")
    tiny = jc.io.read_angles(path, "isb-degrees")
    np.testing.assert_allclose(tiny.values[:, 0], np.radians([0.1, 1.2, 0.4]))
    read = jc.io.read_angles(path, "isb-radians")
    knee = jc.biomechanics.gather_angle_samples([read], "knee_r")
    # flexion turns the shank backward: about -Z of anatomical axes
    np.testing.assert_allclose(
        Rotation.from_quat(knee.rotations, scalar_first=True).as_rotvec()[:, 2],
        [-0.1, -1.2, -0.4],
        atol=1e-12,
    )
    with pytest.raises(jc.InputError, match="no angles of 'hip_r'; there are those of knee_r"):
        jc.biomechanics.gather_angle_samples([read], "hip_r")
    with pytest.raises(jc.InputError, match="'Bein' is no anatomical joint"):
        jc.biomechanics.gather_angle_samples([read], "Bein")
    path.write_text("time,knee_angle_r\n0,10\n0.1,120\n0.2,40\n")
    with pytest.raises(jc.InputError, match="more than a turn in radians; give --convention isb"):
        jc.io.read_angles(path, "isb-radians")
    path.write_text("time,knie\n0,10\n0.1,120\n0.2,40\n")
    with pytest.raises(jc.InputError, match="the columns time, knie are no joint angles"):
        jc.io.read_angles(path, "isb")


def test_names_and_people_of_tables_are_counted(tmp_path):
    path = tmp_path / "knee.csv"
    path.write_text("time,knee_angle_r\n0,10\n0.1,120\n0.2,40\n")
    tables = [jc.io.read_angles(path, "isb")] * 2
    with pytest.raises(jc.InputError, match="There are 1 names of people for 2 motions"):
        jc.biomechanics.gather_angle_samples(tables, "knee_r", people=["anna"])
    with pytest.raises(jc.InputError, match="There are 3 names for 2 tables"):
        jc.biomechanics.gather_angle_samples(tables, "knee_r", names=["a", "b", "c"])
    with pytest.raises(jc.InputError, match="There are no tables"):
        jc.biomechanics.gather_angle_samples([], "knee_r")


def test_units_in_the_header_of_a_table_of_opensim_count(tmp_path):
    """Tiny angles are refused without a unit only; a header states one."""
    angles = np.radians([[0.1], [1.2], [0.4]])
    for title, in_degrees in (("Joint angles", True), ("Coordinates", True), ("Coordinates", False)):
        path = tmp_path / "knee.mot"
        values = np.degrees(angles) if in_degrees else angles
        write_storage(path, ["knee_angle_r"], values, 10.0, in_degrees=in_degrees, title=title)
        own = "isb" if in_degrees else "isb-radians"
        np.testing.assert_allclose(jc.io.read_angles(path, own).values, angles, atol=1e-9)
    with pytest.raises(
        jc.InputError, match="header says that angles are in radians; give --convention isb-radians"
    ):
        jc.io.read_angles(path, "isb")


def test_structs_of_matlab_are_not_merged(tmp_path):
    path, knee = tmp_path / "angles.mat", np.linspace(5.0, 60.0, 20)
    savemat(path, {"walk": {"knee_angle_r": knee, "text": "a"}, "info": {"mass": 70.0}, "rate": 100.0})
    read = jc.io.read_angles(path, "isb")
    assert (read.names, read.rate) == (("knee_angle_r",), 100.0)
    np.testing.assert_allclose(read.values[:, 0], np.radians(knee))
    savemat(path, {"walk": {"knee_angle_r": knee}, "run": {"knee_angle_r": 2 * knee}, "rate": 100.0})
    with pytest.raises(
        jc.InputError, match="joint angles in the struct 'walk', the struct 'run'; save those of one"
    ):
        jc.io.read_angles(path, "isb")
    savemat(path, {"walk": {"knee_angle_r": knee}, "hip_flexion_r": knee, "rate": 100.0})
    with pytest.raises(jc.InputError, match="joint angles in the top, the struct 'walk'"):
        jc.io.read_angles(path, "isb")


def test_files_of_matlab_that_expand_without_end_are_refused(tmp_path):
    path = tmp_path / "bomb.mat"
    savemat(path, {"knee_angle_r": np.linspace(0, 60, 20), "rate": 30.0})
    zeros = zlib.compress(bytes(2**28), 9)
    element = np.array([15, len(zeros)], "<u4").tobytes() + zeros
    path.write_bytes(path.read_bytes() + element)
    with pytest.raises(jc.InputError, match="expands to more than 134 MB"):
        jc.io.read_angles(path, "isb")
    path.write_bytes(b"no file of MATLAB, but long enough" * 10)
    with pytest.raises(jc.InputError, match="no MATLAB file, or a damaged one"):
        jc.io.read_angles(path, "isb")
