"""`jaxcap markers` with two people and a prop in one recording."""

import csv
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest
from command_line import fails, runs

import jaxcap as jc
from jaxcap.body.pose import Motion
from jaxcap.cli.markers import fit_person
from jaxcap.cli.markers.fit import Fit
from jaxcap.cli.markers.prop_tables import write_prop_table
from jaxcap.cli.markers.subject_files import check_subject_place, place_of, subject_names
from jaxcap.errors import InputError
from jaxcap.markers.human.human_template import make_human_template
from jaxcap.markers.marker_sets.recognise import recognise_markers
from jaxcap.markers.motion.inverse_kinematics import MarkerSolution
from jaxcap.markers.subjects.prop import fit_prop

LEGS = [
    "LASI",
    "RASI",
    "LPSI",
    "RPSI",
    "LKNE",
    "RKNE",
    "LKNM",
    "RKNM",
    "LANK",
    "RANK",
    "LHEE",
    "RHEE",
    "LTOE",
    "RTOE",
]
FRAMES = 20
SHAPE = np.array([[0.0, 0, 0], [0.5, 0, 0], [0.2, 0.1, 0], [0.1, 0, 0.12]])


def stepping(number):
    """Markers of the legs of a person who bends hips and knees, and turns."""
    subject = make_human_template(recognise_markers(LEGS)).subject
    poses = []
    for frame in range(FRAMES):
        pose = jc.rest_pose(subject.skeleton)
        rotations, shifts = np.array(pose.rotations), np.array(pose.translations)
        for name, size in (("LeftUpLeg", 0.5), ("RightUpLeg", -0.5), ("LeftLeg", 0.6), ("RightLeg", 0.9)):
            bend = -size * np.sin(0.3 * frame + number) if "Up" in name else size * (1 - np.cos(0.3 * frame))
            rotations[subject.skeleton.index(name)] = np.asarray(jc.geometry.rotation.exp(np.array([bend, 0, 0])))  # fmt: skip
        rotations[0] = np.asarray(jc.geometry.rotation.exp(np.array([0, 0.05 * frame, 0])))
        shifts[0] = [1.2 * number, 0, 0.05 * frame]
        poses.append(jc.Pose(jnp.asarray(shifts), jnp.asarray(rotations), pose.scale))
    motion = jc.stack_poses(poses, 30.0)
    places = np.stack([np.asarray(jc.markers.marker_positions(subject, motion[f])) for f in range(FRAMES)])
    return places + 5e-4 * np.random.default_rng(number).normal(size=places.shape)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("several")
    sword = np.stack([SHAPE + [0.6, 1.0 + 0.02 * f, 0.0] for f in range(FRAMES)])
    places = np.concatenate([stepping(0), stepping(1), sword], 1)
    labels = [f"Anna:{one}" for one in LEGS] + [f"Ben:{one}" for one in LEGS] + [f"Sword:{k}" for k in range(4)]  # fmt: skip
    jc.write_markers(folder / "take.c3d", jc.make_markers(places, labels, 30.0))
    return folder


def test_people_and_a_prop_from_a_take_to_motions(capsys, folder, tmp_path):
    """Each has a file of its own, by its name; so have their motions, and the prop a table of its frames."""
    said = runs(capsys, "markers", "info", folder / "take.c3d")
    assert "people: Anna (14 markers), Ben (14 markers)" in said and "props: Sword (4 markers)" in said
    out = tmp_path / "subjects"
    said = runs(capsys, "markers", "fit", folder / "take.c3d", "-o", out, "--frames", "10")
    assert "people: Anna, Ben; props: Sword" in said and "a rigid prop of 4 markers" in said
    assert sorted(path.name for path in out.iterdir()) == ["Anna.npz", "Ben.npz", "Sword.npz"]
    assert jc.io.load_subject(out / "Ben.npz").labels == tuple(LEGS)
    assert "already exists" in fails(capsys, "markers", "fit", folder / "take.c3d", "-o", out)
    files = [out / f"{name}.npz" for name in ("Anna", "Sword")]
    runs(capsys, "markers", "solve", *files, folder / "take.c3d", "-o", tmp_path / "motion.npz")
    rows = list(csv.DictReader((tmp_path / "motion-Sword-frames.csv").read_text().splitlines()))
    rise = [float(row["y"]) for row in rows]
    np.testing.assert_allclose(np.diff(rise), 0.02, atol=1e-5)
    assert float(rows[0]["dx"]) < 1e-3
    motion = jc.load_motion(tmp_path / "motion-Anna.npz", jc.io.load_subject(files[0]).skeleton)
    assert isinstance(motion, Motion) and len(motion) == FRAMES


def test_results_that_would_be_one_file_are_refused(capsys, tmp_path):
    """Both names become `Box_1`."""
    places = np.stack([np.concatenate([SHAPE + [0.02 * f, 0, 0], SHAPE + [1, 0.02 * f, 0]]) for f in range(FRAMES)])  # fmt: skip
    labels = [f"{name}:{k}" for name in ("Box 1", "Box_1") for k in range(4)]
    jc.write_markers(tmp_path / "boxes.trc", jc.make_markers(places, labels, 30.0))
    said = fails(capsys, "markers", "fit", tmp_path / "boxes.trc", "-o", tmp_path / "out")
    assert "Box_1.npz: two results would be this same file" in said and not (tmp_path / "out").exists()


def test_the_table_of_a_prop_counts_no_outliers(tmp_path):
    prop = fit_prop(jc.make_markers(SHAPE + 0.02 * np.arange(3)[:, None, None], list("abcd"), 30.0))
    frames = jc.make_markers(np.zeros((3, 4, 3)), list("abcd"), 30.0)
    residuals = np.full((3, 4), 1e-4)
    residuals[1, 0], residuals[2] = 0.2, np.nan
    solution = MarkerSolution(prop.motion, residuals, np.ones((3, 4)), np.array([False, False, True]), ())
    write_prop_table(tmp_path / "frames.csv", prop.subject, solution, frames)
    rows = list(csv.DictReader((tmp_path / "frames.csv").read_text().splitlines()))
    assert float(rows[1]["dx"]) > 1.05 * float(rows[0]["dx"]) and rows[2]["dx"] == ""


def test_recognition_by_geometry_has_the_up_axis_of_the_take(capsys, tmp_path, monkeypatch):
    """Given by --up, or found in the file."""

    def recognise(frames, *, up=None):
        raise InputError(f"up is {up}.")

    monkeypatch.setattr(fit_person, "recognise_by_geometry", recognise)
    places = np.random.default_rng(0).uniform([0, 0, 0], [1.5, 0.5, 0.5], (5, 15, 3))
    jc.write_markers(tmp_path / "lying.c3d", jc.make_markers(places, [f"*{k}" for k in range(15)], 30.0))
    command = ("markers", "fit", tmp_path / "lying.c3d", "--template", "human", "-o", tmp_path / "a.npz")
    assert "up is y." in fails(capsys, *command, "--up", "z")
    assert "up is x." in fails(capsys, *command)


def test_one_subject_of_several_and_names_of_files(capsys, folder, tmp_path):
    runs(capsys, "markers", "fit", folder / "take.c3d", "--subject", "Sword", "-o", tmp_path / "sword.npz")
    assert jc.io.load_subject(tmp_path / "sword.npz").skeleton.names == ("Sword",)
    paths = [tmp_path / name for name in ("subject-Anna-Lena.npz", "subject-Ben.npz")]
    assert subject_names(paths) == ["Anna-Lena", "Ben"]
    assert subject_names(paths[:1]) == ["subject-Anna-Lena"]
    # names in a recording decide, also where all begin with the same word, or have blanks
    files = [Path("ids/S-01.npz"), Path("ids/S-02.npz"), Path("subject-Anna_Lee.npz")]
    assert subject_names(files, ["S-01", "S-02", "Anna Lee"]) == ["S-01", "S-02", "Anna Lee"]
    said = fails(capsys, "markers", "solve", tmp_path / "sword.npz", tmp_path / "sword.npz", folder / "take.c3d", "-o", tmp_path / "x")  # fmt: skip
    assert "two subjects have the name" in said


def test_one_subject_that_fails_does_not_stop_the_others(capsys, folder, tmp_path):
    """The first subject's markers are in another trial, the second is a prop of this one."""
    places = np.stack([SHAPE + [0.6, 1.0 + 0.02 * f, 0.0] for f in range(FRAMES)])
    for name, labels in (("Box", "pqrs"), ("Sword", "abcd")):
        prop = fit_prop(jc.make_markers(places, list(labels), 30.0), name)
        jc.io.save_subject(tmp_path / f"{name}.npz", prop.subject)
    jc.write_markers(
        tmp_path / "trial.c3d", jc.make_markers(places, [f"Sword:{one}" for one in "abcd"], 30.0)
    )
    command = ("markers", "solve", tmp_path / "Box.npz", tmp_path / "Sword.npz", tmp_path / "trial.c3d")
    said = fails(capsys, *command, "-o", tmp_path / "out")
    assert "1 of 2 subjects is not solved. Box: " in said
    assert (tmp_path / "out" / "Sword" / "trial.npz").is_file()
    assert not (tmp_path / "out" / "Box" / "trial.npz").exists()
    # results that exist are found before any subject is solved
    assert "already exists" in fails(capsys, *command, "-o", tmp_path / "out")


def test_a_static_trial_of_a_person_without_a_name_and_a_prop(capsys, tmp_path, monkeypatch):
    """The person is found in the static trial, without the prop's markers."""
    given = {}
    monkeypatch.setattr(
        Fit,
        "fit_subject",
        lambda self, markers, is_prop, static: given.update({markers.name: (is_prop, static)}),
    )
    sword = np.stack([SHAPE + [0.6, 1.0 + 0.05 * f, 0.0] for f in range(FRAMES)])
    places = np.concatenate([stepping(0), sword], 1)
    still = np.repeat(places[:1], FRAMES, 0)
    for prefix in ("Sword:", "Sword"):
        labels = [*LEGS, *(f"{prefix}{k}" for k in range(4))]
        jc.write_markers(tmp_path / "take.c3d", jc.make_markers(places, labels, 30.0))
        jc.write_markers(tmp_path / "still.c3d", jc.make_markers(still, labels, 30.0))
        given.clear()
        runs(capsys, "markers", "fit", tmp_path / "take.c3d", "--static", tmp_path / "still.c3d", "-o", tmp_path / "out")  # fmt: skip
        assert len(given) == 2 and [one for one in given.values() if one[0]] == [(True, None)]
        assert given["person"][1].labels == tuple(LEGS)
    two = [*(f"Anna:{one}" for one in LEGS), *(f"Ben:{one}" for one in LEGS)]
    both = np.concatenate([still[:, : len(LEGS)], still[:, : len(LEGS)] + [1.0, 0, 0]], 1)
    jc.write_markers(tmp_path / "two.c3d", jc.make_markers(both, two, 30.0))
    said = fails(capsys, "markers", "fit", tmp_path / "take.c3d", "--static", tmp_path / "two.c3d", "-o", tmp_path / "out")  # fmt: skip
    assert "The person in the takes has no name, and the static trial has 2 people (Anna, Ben)" in said


def test_a_number_is_no_suffix_of_a_folder(tmp_path):
    assert place_of(tmp_path / "P1.5", "Anna") == tmp_path / "P1.5" / "Anna.npz"
    assert place_of(tmp_path / "P1.npz", "Anna") == tmp_path / "P1-Anna.npz"
    check_subject_place(tmp_path / "P1.5", overwrite=False)
    with pytest.raises(InputError, match="P1.c3d"):
        check_subject_place(tmp_path / "P1.c3d", overwrite=False)
