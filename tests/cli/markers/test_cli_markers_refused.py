"""`jaxcap markers` with files that are wrong: one sentence that says what to do, and nothing left behind."""

import numpy as np
import pytest
from command_line import fails, runs, tree
from markers_scene import puppet

import jaxcap as jc
from jaxcap.cli import main

LABELS = [
    f"{name}{number}" for name in ("trunk", "rarm", "rhand", "larm", "lhand", "head") for number in range(4)
]
PLACES = puppet(np.random.default_rng(5), frames=60, noise=2e-4).places


def write(path, places=PLACES, labels=LABELS, unit=None):
    jc.write_markers(path, jc.make_markers(places, labels, 100.0), unit)
    return path


@pytest.fixture(scope="module")
def subject(tmp_path_factory):
    """A subject of the puppet, as its joints one by one tell it."""
    path = tmp_path_factory.mktemp("subject") / "subject.npz"
    jc.io.save_subject(path, jc.markers.fit_local(jc.make_markers(PLACES, LABELS, 100.0)).subject)
    return path


def wrong_file(name, folder):
    """A file that is wrong, and what is said of it."""
    path, whole = folder / name, write(folder / "whole.c3d").read_bytes()
    content, said = {
        "empty.c3d": (b"", "the file is empty"),
        "text.c3d": (b"These are my markers.", "not a C3D file"),
        # its second letter is a P, as that of C3D's is
        "picture.c3d": (b"\x89PNG\r\n" + 9000 * b"x", "not a C3D file, or it is cut short within its header"),
        "header.c3d": (whole[:400], "cut short within its header"),
        "parameters.c3d": (whole[:900], "damaged within its parameters"),
        "before.c3d": (whole[:1900], "it ends before the last of its 60 frames"),
        "frames.c3d": (whole[: len(whole) // 2], "of the 60 frames of its header"),
        "empty.trc": (b"", "the file is empty"),
        "empty.csv": (b"", "the table is empty"),
        "text.trc": (b"These are my markers.", "not a TRC file"),
        "table.csv": (b"PathFileType\t4\t(X/Y/Z)\ta.trc\n", "this is a TRC file"),
        "picture.csv": (b"\x89PNG\r\n\x1a\n\0\0", "this is a binary file"),
    }[name]
    path.write_bytes(content)
    (folder / "whole.c3d").unlink()
    return path, said


NAMES = ("empty.c3d", "text.c3d", "picture.c3d", "header.c3d", "parameters.c3d", "before.c3d", "frames.c3d", "empty.trc",
         "empty.csv", "text.trc", "table.csv", "picture.csv")  # fmt: skip


@pytest.mark.parametrize("name", NAMES)
def test_a_wrong_file_is_refused_by_every_verb(capsys, subject, tmp_path, name):
    path, said = wrong_file(name, tmp_path)
    report = ("--report", tmp_path / "report")
    for command in (
        ("info", path),
        ("fit", path, "-o", tmp_path / "s.npz", *report),
        ("solve", subject, path, "-o", tmp_path / "out.bvh", *report),
    ):
        line = fails(capsys, "markers", *command)
        assert said in line and str(path) in line
    assert [file.name for file in tmp_path.iterdir()] == [name]


def test_a_folder_is_no_file(capsys, tmp_path):
    (tmp_path / "folder.c3d").mkdir()
    assert "Is a directory" in fails(capsys, "markers", "info", tmp_path / "folder.c3d")


def test_a_refusal_names_the_option(capsys, subject, tmp_path):
    far = write(tmp_path / "far.csv", unit="mm")
    two = write(tmp_path / "two.c3d", labels=[f"{'Anna' if i < 12 else 'Ben'}:{label}" for i, label in enumerate(LABELS)])  # fmt: skip
    fit, solve = ("markers", "fit", "-o", tmp_path / "s.npz"), ("markers", "solve", subject)
    for command in ((*fit, far), (*solve, far, "-o", tmp_path / "o.bvh")):
        assert "looks like millimetres: give --unit mm" in fails(capsys, *command)
    assert "select one with --subject Anna" in fails(capsys, *fit, two)
    assert "select one with --subject Anna" in fails(capsys, *solve, two, "-o", tmp_path / "o.bvh")


def test_what_is_refused_late_leaves_no_folder(capsys, tmp_path):
    still = write(tmp_path / "still.c3d", np.repeat(PLACES[:1], 20, 0))
    assert "All 20 frames are equal" in fails(
        capsys, "markers", "fit", still, "-o", tmp_path / "s.npz", "--report", tmp_path / "report"
    )
    assert not (tmp_path / "report").exists()
    assert "so the folder cannot be created" in fails(
        capsys, "markers", "fit", still, "-o", tmp_path / "s.npz", "--report", still / "report"
    )


def test_no_trial_is_written_where_one_is_wrong(capsys, subject, tmp_path):
    good = write(tmp_path / "good.c3d")
    (tmp_path / "bad.c3d").write_bytes(good.read_bytes()[:-9000])
    command = ("markers", "solve", subject, good, tmp_path / "bad.c3d", "-o", tmp_path / "out")
    assert "bad.c3d: the file is cut short" in fails(capsys, *command)
    assert set(tree(tmp_path)) == {"good.c3d", "bad.c3d"} and not (tmp_path / "out").exists()


def test_joint_centres_are_not_replaced_unasked(capsys, tmp_path):
    take, joints = write(tmp_path / "take.c3d"), tmp_path / "joints.trc"
    joints.write_text("old")
    command = ("markers", "fit", take, "-o", tmp_path / "s.npz", "--local", "--joints", joints)
    assert "joints.trc: this file already exists" in fails(capsys, *command)
    assert joints.read_text() == "old"


def test_one_stiff_body_is_told(capsys, rng, tmp_path):
    """Noise alone moves, so the markers are one segment: a sentence, and no empty table."""
    take = write(tmp_path / "stiff.c3d", PLACES[:1] + 2e-4 * rng.normal(size=PLACES.shape))
    told = runs(capsys, "markers", "fit", take, "-o", tmp_path / "s.npz", "--local")
    assert "one segment without a joint" in told
    assert "precision" not in told


def test_two_bodies_without_prefixes_are_told(capsys, tmp_path):
    """Where a joint may be anywhere within metres, nothing says that its sides belong together."""
    rng = np.random.default_rng(3)
    one, two = puppet(rng, frames=120).places, puppet(rng, frames=120).places
    labels = [*LABELS, *(f"b{label}" for label in LABELS)]
    take = write(tmp_path / "two.c3d", np.concatenate([one, two + np.array([2.0, 0.5, 0.0])], 1), labels)
    told = runs(capsys, "markers", "fit", take, "-o", tmp_path / "s.npz", "--local")
    assert "on another subject" in told or "They are left out; fit them separately." in told


def test_markers_far_from_their_place_are_told(capsys, subject, tmp_path):
    """A marker that was moved onto another place hides in the median over all of them."""
    moved = PLACES.copy()
    moved[20:, LABELS.index("rhand2")] += 0.1
    take = write(tmp_path / "moved.c3d", moved)
    main(["markers", "solve", str(subject), str(take), "-o", str(tmp_path / "o.bvh")])
    assert (
        "more than 5 cm from their predicted positions: rhand2 in 67 % of the frames"
        in capsys.readouterr().err
    )
