"""`jaxcap markers solve` with OpenSim models: coordinates that made the markers come back, and what is refused."""

import numpy as np
import pytest
from command_line import fails, runs, tree

import jaxcap as jc
from tests.io.osim.made_osim import write_osim

BEND = np.linspace(-1.5, 0.0, 8)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A model, a trial that begins at 0.5 s, and tasks."""
    folder = tmp_path_factory.mktemp("opensim")
    model, subject = jc.io.read_osim(write_osim(folder / "leg.osim"))
    values = np.tile(model.defaults, (len(BEND), 1))
    values[:, model.index("knee")] = BEND
    poses = jc.body.motion_from_coordinates(model, values, 100.0)
    places = np.array([jc.markers.marker_positions(subject, poses[frame]) for frame in range(len(BEND))])
    jc.write_markers(folder / "bend.trc", jc.make_markers(places, subject.labels, 100.0))
    lines = (folder / "bend.trc").read_text().splitlines()
    for number in range(len(BEND)):
        cells = lines[6 + number].split("\t")
        lines[6 + number] = "\t".join([cells[0], f"{0.5 + number / 100:.3f}", *cells[2:]])
    (folder / "bend.trc").write_text("\n".join(lines) + "\n")
    tasks = "".join(
        f'<IKMarkerTask name="{label}"><weight>2</weight></IKMarkerTask>' for label in subject.labels
    )
    (folder / "tasks.xml").write_text(f"<IKTaskSet>{tasks}</IKTaskSet>")
    return folder


@pytest.mark.parametrize("more", [(), ("--tasks", "tasks.xml")])
def test_coordinates_of_a_trial_come_back(capsys, folder, tmp_path, more):
    more = [folder / word if word.endswith("xml") else word for word in more]
    said = runs(
        capsys,
        "markers",
        "solve",
        folder / "leg.osim",
        folder / "bend.trc",
        "-o",
        tmp_path / "out.mot",
        *more,
    )
    table = jc.io.read_storage(tmp_path / "out.mot")
    np.testing.assert_allclose(table.values[:, table.names.index("knee")], np.degrees(BEND), atol=0.02)
    assert table.start == pytest.approx(0.5)
    assert "coordinates: " in said


def test_a_folder_gets_all_formats_and_they_are_one_motion(capsys, folder, tmp_path):
    runs(capsys, "markers", "solve", folder / "leg.osim", folder / "bend.trc", "-o", tmp_path / "out")
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == ["bend.bvh", "bend.mot", "bend.npz"]
    runs(
        capsys,
        "convert",
        tmp_path / "out" / "bend.mot",
        tmp_path / "again.npz",
        "--body",
        folder / "leg.osim",
    )
    first, second = (jc.load_motion(path) for path in (tmp_path / "out" / "bend.npz", tmp_path / "again.npz"))
    np.testing.assert_allclose(first.poses.rotations, second.poses.rotations, atol=1e-5)
    np.testing.assert_allclose(first.poses.translations, second.poses.translations, atol=1e-5)


def test_files_are_described(capsys, folder, tmp_path):
    said = runs(capsys, "info", folder / "leg.osim")
    assert "13 coordinates, 12 free, 1 with a range; 12 markers" in said
    jc.io.write_storage(tmp_path / "a.mot", ["x"], np.zeros((4, 1)), 50.0, in_degrees=True)
    assert "table: 4 rows at 50 a second" in runs(capsys, "info", tmp_path / "a.mot")


def test_what_does_not_fit_is_refused(capsys, folder, tmp_path):
    trial, out = folder / "bend.trc", tmp_path / "out.mot"
    assert "--stream is for subjects" in fails(
        capsys, "markers", "solve", folder / "leg.osim", trial, "-o", out, "--stream"
    )
    model, subject = jc.io.read_osim(folder / "leg.osim")
    jc.io.save_subject(tmp_path / "subject.npz", subject)
    assert "coordinates are those of an OpenSim model" in fails(
        capsys, "markers", "solve", tmp_path / "subject.npz", trial, "-o", out
    )
    assert "--tasks is for OpenSim models" in fails(
        capsys, "markers", "solve", tmp_path / "subject.npz", trial, "-o", tmp_path / "out.bvh", "--tasks", folder / "tasks.xml"
    )  # fmt: skip
    bare = write_osim(tmp_path / "bare.osim", markers="")
    assert "the model has no markers" in fails(capsys, "markers", "solve", bare, trial, "-o", out)
    jc.io.write_coordinates(out, model, np.zeros((2, len(model.names))), 10.0)
    of_model = ("--body", folder / "leg.osim")
    assert "an OpenSim model has no surface" in fails(capsys, "convert", out, tmp_path / "a.glb", *of_model)
    # it is a source of other bodies, by the names of its joints
    said = fails(capsys, "convert", out, tmp_path / "a.npz", *of_model, "--to", "human:low")
    assert "match a joint of the target" in said
    write_osim(tmp_path / "second.osim")
    assert "the folder has 2 OpenSim models" in fails(capsys, "convert", out, tmp_path / "a.bvh")
    assert not tree(tmp_path / "a.bvh")
