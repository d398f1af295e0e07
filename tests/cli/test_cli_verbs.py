"""The verbs beside `track`, and what holds for all of them."""

import json
import subprocess

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
import trimesh
from command_line import FRAMES, PYTHON, fails, runs, tree, write_inputs

from jaxcap.body.kinematics import forward_kinematics, joint_positions
from jaxcap.body.people.human import human
from jaxcap.cli import main
from jaxcap.io.archives.npz import load_body, load_motion, load_skeleton
from jaxcap.io.meshes.mesh import Mesh, read_mesh, write_mesh
from jaxcap.io.skeletons.bvh import read_bvh, write_bvh
from jaxcap.io.skeletons.skl import read_skl, write_skl

VERBS = ("demo", "rig", "learn", "fit", "track", "live", "scan", "evaluate", "info", "convert")


@pytest.fixture(scope="module")
def inputs(tmp_path_factory):
    return write_inputs(tmp_path_factory.mktemp("inputs"))


def test_help_names_every_verb(capsys):
    with pytest.raises(SystemExit) as stop:
        main(["--help"])
    assert not stop.value.code
    told = capsys.readouterr().out
    assert all(verb in told for verb in VERBS)


@pytest.mark.parametrize("verb", VERBS)
def test_help_explains_every_option(capsys, verb):
    with pytest.raises(SystemExit) as stop:
        main([verb, "--help"])
    assert not stop.value.code
    assert "usage: jaxcap" in capsys.readouterr().out


def test_version(capsys, checkout):
    told = runs(capsys, "--version")
    assert told.startswith("jaxcap ")
    assert len(told.split()) >= 2


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["trak", "human"], "there is no 'jaxcap trak' (did you mean 'track'?); verbs are demo, rig,"),
        (["limits", "dance"], "there is no 'jaxcap limits dance'; verbs are learn, check,"),
        (["track"], "missing from jaxcap track: BODY, -o OUT, --out OUT; 'jaxcap track --help' lists"),
        (["track", "human", "x", "-o", "y", "--sigm", "3"], "--sigm"),
        (["track", "human", "x", "-o", "y", "--sigma0", "abc"], "jaxcap: --sigma0 is 'abc'; give a number."),
        (["track", "human", "x", "-o", "y", "--first", "1.5"], "jaxcap: --first is '1.5'; give an integer."),
        (["track", "human", "x", "-o", "y", "--first"], "jaxcap: --first lacks a value; give an integer."),
        (["track", "human", "x", "-o"], "jaxcap: --out lacks a value; give one."),
        (
            ["convert", "a.csv", "-o", "b.c3d"],
            "jaxcap: missing from jaxcap convert: TARGET, which is written without an option such as -o; ",
        ),
        (["ik", "human", "--port", "x 'y\" z"], "jaxcap: --port is 'x 'y\" z'; give an integer."),
        (
            ["adapt", "human", "x", "-o", "y", "--shape-weight", "1", "b"],
            "jaxcap: --shape-weight is '1 b'; give 2 numbers.",
        ),
        (
            ["edit", "cut", "a", "-o", "b", "--seconds", "1", "x"],
            "jaxcap: --seconds is '1 x'; give 2 numbers.",
        ),
        (
            ["convert", "a.npz", "b.npz", "--as", "foo"],
            "jaxcap: --as is 'foo'; give amass, angles, body or smpl.",
        ),
        (
            ["scan", "human", "m", "-o", "x", "--as", "foo"],
            "jaxcap: --as is 'foo'; give cloud, mesh or depth.",
        ),
        (["markers", "fit", "a.c3d", "--up", "q"], "jaxcap: --up is 'q'; give x, y, z, -x, -y or -z."),
        (["--foo"], "scan, markers, limits,"),
    ],
)
def test_wrong_words_are_one_sentence(capsys, words, sentence):
    said = fails(capsys, *words)
    assert sentence in said
    assert not set(said) & set("│╭─")
    assert "None" not in said


def test_no_words_tell_the_help(capsys):
    for words in ([], ["edit"]):
        with pytest.raises(SystemExit) as stop:
            main(words)
        assert not stop.value.code
        assert "usage: jaxcap" in capsys.readouterr().out


def test_faults_of_ours_show_where(monkeypatch, capsys):
    """A sentence is for errors that jaxcap raised; an error from inside a library is not hidden."""
    from jaxcap.cli import info

    monkeypatch.setattr(info.Info, "run", lambda self: np.zeros(3).reshape(2, 2))
    with pytest.raises(ValueError, match="reshape"):
        main(["info", "human"])
    monkeypatch.setattr(info.Info, "run", lambda self: human(age=3))
    assert "age" in fails(capsys, "info", "human")


def test_help_loads_no_heavy_library():
    """What makes a program slow to start is imported by the verbs that need it."""
    heavy = ("trimesh", "matplotlib", "rich.progress")
    code = (
        "import sys, contextlib\nfrom jaxcap.cli import main\n"
        "with contextlib.suppress(SystemExit): main(['--help'])\n"
        f"sys.exit(', '.join(name for name in {heavy} if name in sys.modules) or 0)"
    )
    done = subprocess.run([PYTHON, "-c", code], capture_output=True, text=True, timeout=120, check=False)
    assert (done.returncode, done.stderr) == (0, "")


def test_evaluate_the_truth_itself(inputs, tmp_path, capsys):
    """The true motion leaves the scanner's noise between scan and surface, and no error at joints."""
    told = runs(
        capsys, "evaluate", inputs / "body.npz", inputs / "truth.npz", inputs / "clouds.npz",
        "--truth", inputs / "truth.npz", "-o", tmp_path / "report.json",
    )  # fmt: skip
    report = json.loads((tmp_path / "report.json").read_text())
    surface = report["scan_to_surface"]
    assert report["frames"] == len(report["per_frame"]) == FRAMES
    # noise of 4 mm along the line of sight, which meets the surface at all angles
    assert 0.001 < surface["mean"] < 0.004
    assert 0 < surface["mad"] < surface["iqr"] < surface["sd"] * 2
    assert report["joint_centres"]["mean"] == 0.0
    assert f"{1000 * surface['mean']:.2f}" in told
    assert f"{1000 * surface['iqr']:.2f}" in told
    # refused before anything is read
    line = fails(capsys, "evaluate", "gone.npz", "gone.npz", "gone.npz", "-o", tmp_path / "report.json")
    assert "report.json: this file already exists; give --overwrite to replace it" in line


def test_evaluate_knows_how_far_a_motion_is_off(inputs, tmp_path, capsys):
    """A motion moved by 3, 4 and 0 cm has joints 5 cm from the truth; from BVH just as well."""
    with np.load(inputs / "truth.npz") as file:
        arrays = dict(file)
    arrays["translations"][:, 0] += [0.03, 0.04, 0.0]
    np.savez(tmp_path / "moved.npz", **arrays)
    moved = load_motion(tmp_path / "moved.npz")
    write_bvh(tmp_path / "moved.bvh", load_skeleton(tmp_path / "moved.npz"), moved)
    for name in ("moved.npz", "moved.bvh"):
        runs(
            capsys, "evaluate", inputs / "body.npz", tmp_path / name, inputs / "clouds.npz",
            "--truth", inputs / "truth.npz", "-o", tmp_path / "report.json", "--points", "50", "--overwrite",
        )  # fmt: skip
        joints = json.loads((tmp_path / "report.json").read_text())["joint_centres"]
        assert joints["mean"] == pytest.approx(0.05, abs=1e-5)
        assert joints["sd"] == pytest.approx(0.0, abs=1e-5)


def test_evaluate_against_joint_positions(inputs, tmp_path, capsys):
    body, motion = load_body(inputs / "body.npz"), load_motion(inputs / "truth.npz")
    joints = np.array(
        [joint_positions(body.skeleton, forward_kinematics(body.skeleton, motion[i])) for i in range(FRAMES)]
    )
    chosen = [3, 7]
    names = np.array([body.skeleton.names[joint] for joint in chosen])
    np.savez(tmp_path / "joints.npz", joints=joints[:, chosen] + [0, 0, 0.01], names=names)
    arguments = ["evaluate", inputs / "body.npz", inputs / "truth.npz", inputs / "clouds.npz"]
    runs(
        capsys,
        *arguments,
        "--truth",
        tmp_path / "joints.npz",
        "-o",
        tmp_path / "report.json",
        "--points",
        "20",
    )
    report = json.loads((tmp_path / "report.json").read_text())["joint_centres"]
    assert report["by_joint"] == pytest.approx(dict.fromkeys(names.tolist(), 0.01))
    assert report["count"] == 2 * FRAMES
    np.savez(tmp_path / "joints.npz", joints=joints[:2], names=np.array(body.skeleton.names))
    assert "2 frames" in fails(capsys, *arguments, "--truth", tmp_path / "joints.npz")


def test_motion_of_another_person_is_refused(inputs, tmp_path, capsys):
    write_bvh(
        tmp_path / "m.bvh", human(resolution="low", height=1.6).skeleton, load_motion(inputs / "truth.npz")
    )
    line = fails(capsys, "evaluate", inputs / "body.npz", tmp_path / "m.bvh", inputs / "clouds.npz")
    assert "another skeleton" in line


def test_convert_a_motion_there_and_back(inputs, tmp_path, capsys):
    runs(capsys, "convert", inputs / "truth.npz", tmp_path / "m.bvh")
    runs(capsys, "convert", tmp_path / "m.bvh", tmp_path / "m.npz")
    runs(capsys, "convert", tmp_path / "m.npz", tmp_path / "again.bvh")
    first, second = (read_bvh(tmp_path / name) for name in ("m.bvh", "again.bvh"))
    assert first[0].names == second[0].names
    np.testing.assert_allclose(first[1].poses.rotations, second[1].poses.rotations, atol=1e-5)
    assert "--overwrite" in fails(capsys, "convert", inputs / "truth.npz", tmp_path / "m.bvh")


def test_convert_a_mesh_and_its_unit(tmp_path, capsys):
    ball = trimesh.creation.icosphere(1, 1.0)
    write_mesh(tmp_path / "ball.off", Mesh(np.asarray(ball.vertices), np.asarray(ball.faces)))
    for suffix in ("obj", "ply", "glb"):
        runs(capsys, "convert", tmp_path / "ball.off", tmp_path / f"ball.{suffix}", "--target-unit", "mm")
        back = read_mesh(tmp_path / f"ball.{suffix}", "mm")
        np.testing.assert_allclose(back.vertices, ball.vertices, atol=1e-6)
        np.testing.assert_array_equal(back.faces, ball.faces)


def test_convert_a_skeleton(inputs, tmp_path, capsys):
    runs(capsys, "convert", inputs / "body.npz", tmp_path / "body.skl")
    skeleton = load_body(inputs / "body.npz").skeleton
    again = read_skl(tmp_path / "body.skl")
    assert (again.names, again.parents, again.kinds) == (skeleton.names, skeleton.parents, skeleton.kinds)


def test_convert_says_what_cannot_be(inputs, tmp_path, capsys):
    before = tree(tmp_path)
    assert "write .bvh" in fails(capsys, "convert", inputs / "truth.npz", tmp_path / "m.amc")
    assert tree(tmp_path) == before


def test_info_says_what_is_in_a_file(inputs, tmp_path, capsys):
    assert "1500 vertices" in runs(capsys, "info", inputs / "body.npz")
    assert f"{FRAMES} frames at 30 frames per second" in runs(capsys, "info", inputs / "truth.npz")
    assert f"clouds: {FRAMES} frames" in runs(capsys, "info", inputs / "clouds.npz")
    assert "31 joints" in runs(capsys, "info", "human")
    (tmp_path / "one.off").write_text("OFF\n4 1 0\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n3 0 1 2\n")
    told = runs(capsys, "info", tmp_path / "one.off")
    assert "4 vertices, 1 face," in told
    assert "0 faces without area and 1 vertex that no other face uses" in told
    (tmp_path / "notes.txt").write_text("nothing")
    assert ".txt" in fails(capsys, "info", tmp_path / "notes.txt")


def test_rig_by_envelopes(inputs, tmp_path, capsys):
    """A mesh and a skeleton in it, both in centimetres with z up, become a body in metres with y up."""
    body = load_body(inputs / "body.npz")
    vertices, faces = np.asarray(body.vertices), np.asarray(body.faces)
    z_up = lambda points: np.asarray(points)[..., [0, 2, 1]] * [1, -1, 1]  # noqa: E731
    write_mesh(tmp_path / "mesh.obj", Mesh(z_up(vertices), faces), "cm")
    lying = eqx.tree_at(lambda s: s.centres, body.skeleton, jnp.asarray(z_up(body.skeleton.centres)))
    write_skl(tmp_path / "mesh.skl", lying, "cm")
    out = tmp_path / "rigged.npz"
    command = ["rig", tmp_path / "mesh.obj", "-o", out, "--skeleton", tmp_path / "mesh.skl", "--up", "z"]
    command += ["--method", "envelopes"]
    assert "centimetres" in fails(capsys, *command)
    assert not out.exists()
    runs(capsys, *command, "--unit", "cm")
    rigged = load_body(out)
    assert rigged.skeleton.names == body.skeleton.names
    np.testing.assert_allclose(rigged.vertices, vertices, atol=1e-6)
    np.testing.assert_allclose(rigged.skeleton.centres, body.skeleton.centres, atol=1e-6)
    # of the vertices that one bone moves at least nine in ten get this bone or one beside it
    weights = np.asarray(body.skin.bone_weights(31))
    sure, true, found = weights.max(1) > 0.95, weights.argmax(1), np.asarray(rigged.skin.dominant_bones())
    parents = np.array(body.skeleton.parents)
    near = (true == found) | (parents[true] == found) | (parents[found] == true)
    assert near[sure].mean() > 0.9
    assert "--overwrite" in fails(capsys, *command, "--unit", "cm")
