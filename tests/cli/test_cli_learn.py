"""`jaxcap learn` and `jaxcap fit`: options, bad inputs, checkpoints, scores and pictures."""

import json
from pathlib import Path

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from command_line import fails, runs, tree
from scipy.spatial.transform import Rotation

from jaxcap.body.body import Body
from jaxcap.body.pose import Motion, Pose
from jaxcap.body.skeleton import make_skeleton
from jaxcap.body.skin import LinearSkin
from jaxcap.cli.learn import learn as verb
from jaxcap.cli.learn.input import read_pairs, split_held_out
from jaxcap.errors import InputError
from jaxcap.io.archives.npz import load_body, load_motion, save_body
from jaxcap.learn.learn_body import Learned, LearnState

SIDES, RINGS, FRAMES = 8, 9, 6


def bar() -> Body:
    """A closed bar of 0.8 m with a joint in its middle."""
    angles = 2 * np.pi * np.arange(SIDES) / SIDES
    heights = np.linspace(0, 0.8, RINGS)
    rings = np.array([[0.1 * np.cos(a), y, 0.05 * np.sin(a)] for y in heights for a in angles])
    vertices = np.concatenate([rings, [[0, -0.02, 0], [0, 0.82, 0]]])
    around = np.arange(SIDES)
    after = (around + 1) % SIDES
    faces = [np.stack([around, after, np.full(SIDES, len(rings))], 1)]
    for ring in range(RINGS - 1):
        low, high = ring * SIDES, (ring + 1) * SIDES
        faces += [np.stack([low + around, high + around, low + after], 1)]
        faces += [np.stack([low + after, high + around, high + after], 1)]
    faces += [np.stack([high + after, high + around, np.full(SIDES, len(rings) + 1)], 1)]
    share = np.clip(vertices[:, 1] * 5 - 1.5, 0, 1)
    skeleton = make_skeleton(["low", "high"], [-1, 0], ["free", "ball"], [[0, 0, 0], [0, 0.4, 0]])
    skin = LinearSkin(jnp.asarray(np.stack([1 - share, share], 1)))
    return Body(skeleton, skin, jnp.asarray(vertices), jnp.asarray(np.concatenate(faces)))


def poses() -> Pose:
    turns = Rotation.from_rotvec(np.linspace(0, 1.2, FRAMES)[:, None] * [[0.3, 0.2, 1.0]]).as_quat()
    rotations = np.tile([1.0, 0, 0, 0], (FRAMES, 2, 1))
    rotations[:, 1] = turns[:, [3, 0, 1, 2]]
    shifts = np.zeros((FRAMES, 2, 3))
    shifts[:, 0, 0] = 0.1 * np.arange(FRAMES)
    return Pose(jnp.asarray(shifts), jnp.asarray(rotations), jnp.ones(FRAMES))


@pytest.fixture(scope="module")
def inputs(tmp_path_factory):
    """The bar as `bar.npz`, and as it bends, with 1 mm of noise, in `meshes.npz`."""
    folder, body = tmp_path_factory.mktemp("inputs"), bar()
    from jaxcap.body.body import posed_vertices

    meshes = np.asarray(posed_vertices(body, poses()))
    meshes = meshes + 0.001 * np.random.default_rng(0).normal(size=meshes.shape)
    names = np.array([f"bend_{i}" for i in range(FRAMES)])
    np.savez(folder / "meshes.npz", vertices=meshes, faces=np.asarray(body.faces), names=names, rate=12.5)
    save_body(folder / "bar.npz", body)
    return folder


@pytest.fixture
def slow_learner(monkeypatch):
    """In place of learning: rounds that each move the vertices by what the state alone decides, as many as
    are asked; `stop_after` rounds the user has enough. The calls are kept."""
    calls: dict = {"stop_after": None}

    def learn_body(meshes, *, rounds, on_round, resume, **options):
        calls.update(options, meshes=meshes, resume=resume)
        first = Pose(
            *(leaf[: len(meshes)] for leaf in (poses().translations, poses().rotations, poses().scale))
        )
        state = resume or LearnState(bar(), Motion(first), np.array([[1, 0]]), 0.1, (("start", 1.0),), 0)
        while state.round < rounds:
            vertices = state.body.vertices * (1 + state.damping / (3 + state.round))
            state = LearnState(
                eqx.tree_at(lambda b: b.vertices, state.body, vertices),
                state.motion,
                state.left_right_pairs,
                state.damping / 3,
                (*state.history, ("vertices", state.history[-1][1] * 0.7)),
                state.round + 1,
            )
            on_round(state)
            if state.round == calls["stop_after"]:
                raise KeyboardInterrupt
        return Learned(state.body, state.motion, state.left_right_pairs, state.history, np.array([0.1, 0.01]))

    monkeypatch.setattr(verb, "learn_body", learn_body)
    return calls


def test_fit_finds_the_poses_and_scores_them(inputs, tmp_path, capsys):
    out, folder = tmp_path / "motion.npz", tmp_path / "report"
    told = runs(capsys, "fit", inputs / "bar.npz", inputs / "meshes.npz", "-o", out, "--report", folder)
    motion = load_motion(out, bar().skeleton)
    np.testing.assert_allclose(motion.poses.rotations, poses().rotations, atol=0.01)
    np.testing.assert_allclose(motion.poses.translations, poses().translations, atol=0.002)
    report = json.loads((folder / "report.json").read_text())
    total = report["vertex_to_surface"]
    assert total["meshes"] == FRAMES
    # 1 mm of noise in each direction: of it, the surface sees about one
    assert 0.0014 < total["vertex_rmse"] < 0.0018
    assert 0.0004 < total["mean"] < 0.0011
    assert f"{1000 * total['mean']:.2f}" in told
    assert "bend_3" in told
    assert report["per_mesh"][3]["mesh"].endswith("meshes.npz[bend_3]")
    assert (folder / "error.png").read_bytes()[:4] == b"\x89PNG"
    assert "triangles" not in capsys.readouterr().err
    assert "already" in fails(capsys, "fit", inputs / "bar.npz", inputs / "meshes.npz", "-o", out)


def test_fit_refuses_what_does_not_fit(inputs, tmp_path, capsys):
    with np.load(inputs / "meshes.npz") as file:
        vertices = file["vertices"]
    np.savez(tmp_path / "other.npz", vertices=vertices[:, :-2], faces=np.array([[0, 1, 2]]))
    out = ["-o", tmp_path / "motion.npz"]
    assert "72 vertices; expected the 74 vertices of the body" in fails(
        capsys, "fit", inputs / "bar.npz", tmp_path / "other.npz", *out
    )
    assert "no such file" in fails(capsys, "fit", inputs / "bar.npz", tmp_path / "nowhere.npz", *out)
    assert "--unit" in fails(capsys, "fit", inputs / "bar.npz", inputs / "meshes.npz", *out, "--unit", "mm")
    assert "meshes.npz" in fails(capsys, "fit", inputs / "meshes.npz", inputs / "meshes.npz", *out)
    bar_of_meshes = ("fit", inputs / "bar.npz", inputs / "meshes.npz", *out)
    assert "--floor is 820 m, and the data are between" in fails(capsys, *bar_of_meshes, "--floor", "820")
    assert ".bvh" in fails(capsys, "fit", inputs / "bar.npz", inputs / "meshes.npz", "-o", tmp_path / "m.bvh")
    assert list(tmp_path.iterdir()) == [tmp_path / "other.npz"]


def test_learn_writes_body_motion_and_report(inputs, tmp_path, capsys, slow_learner):
    out = tmp_path / "body.npz"
    told = runs(
        capsys, "learn", inputs / "meshes.npz", "-o", out, "--hold-out", "3", "--rounds", "2", "--report",
        tmp_path / "report", "--alpha", "7", "--pairs", "0:1", "--skin", "lbs", "--floor", "-0.5",
    )  # fmt: skip
    assert slow_learner["alpha"] == 7.0
    (floor,) = slow_learner["terms"]
    assert float(floor.height) == -0.5
    assert floor.vertices.max() < slow_learner["meshes"].vertices.shape[1]
    assert slow_learner["skin"] == "lbs"
    np.testing.assert_array_equal(slow_learner["symmetry"], [[0, 1]])
    # meshes 2 and 5 are kept back
    with np.load(inputs / "meshes.npz") as file:
        np.testing.assert_array_equal(slow_learner["meshes"].vertices, file["vertices"][[0, 1, 3, 4]])
    assert load_body(out).skeleton.names == ("low", "high")
    assert load_motion(tmp_path / "body-motion.npz").num_frames == 4
    assert slow_learner["meshes"].rate == 12.5
    report = json.loads((tmp_path / "report" / "report.json").read_text())
    assert [len(report["scores"][label]["per_mesh"]) for label in ("training", "held out")] == [4, 2]
    assert [row["Q"] for row in report["history"]] == pytest.approx([1.0, 0.7, 0.49])
    assert report["settings"]["alpha"] == 7.0
    assert "held out, 2 meshes" in told
    for name in report["pictures"]:
        assert (tmp_path / "report" / name).read_bytes()[:4] == b"\x89PNG"
    assert {"error-held-out.png", "weights.png", "history.png", "parts.png"} <= set(report["pictures"])
    assert not (tmp_path / "body.npz.partial").exists()


def test_a_stopped_run_goes_on_to_the_same_result(inputs, tmp_path, capsys, slow_learner):
    whole, cut = tmp_path / "whole.npz", tmp_path / "cut.npz"
    arguments = ["learn", inputs / "meshes.npz", "--rounds", "5", "-o"]
    runs(capsys, *arguments, whole)
    slow_learner["stop_after"] = 2
    with pytest.raises(SystemExit) as stop:
        runs(capsys, *arguments, cut)
    assert stop.value.code == 130
    assert "round 2 is saved" in capsys.readouterr().err
    partial = tmp_path / "cut.npz.partial"
    assert partial.is_file() and not cut.exists()
    before = tree(tmp_path)
    assert "--resume" in fails(capsys, *arguments, cut)
    assert "alpha" in fails(capsys, *arguments, cut, "--resume", "--alpha", "1")
    with np.load(inputs / "meshes.npz") as file:
        np.savez(tmp_path / "other.npz", vertices=1.01 * file["vertices"], faces=file["faces"])
    assert "meshes" in fails(capsys, "learn", tmp_path / "other.npz", "-o", cut, "--resume")
    (tmp_path / "other.npz").unlink()
    assert tree(tmp_path) == before
    slow_learner["stop_after"] = None
    runs(capsys, *arguments, cut, "--resume")
    assert slow_learner["resume"].round == 2
    assert not partial.exists()
    a, b = load_body(whole), load_body(cut)
    np.testing.assert_array_equal(a.vertices, b.vertices)
    before = tree(tmp_path)
    assert "this run is already complete" in runs(capsys, *arguments, cut, "--resume")
    assert tree(tmp_path) == before


def test_a_run_stopped_before_its_first_round_is_resumed(inputs, tmp_path, capsys, slow_learner):
    """Nothing is kept by then, and whoever resumes cannot know that."""
    arguments = ["learn", inputs / "meshes.npz", "--rounds", "3", "-o"]
    runs(capsys, *arguments, tmp_path / "new.npz", "--resume")
    assert slow_learner["resume"] is None
    runs(capsys, *arguments, tmp_path / "whole.npz")
    a, b = load_body(tmp_path / "whole.npz"), load_body(tmp_path / "new.npz")
    np.testing.assert_array_equal(a.vertices, b.vertices)


def test_a_run_killed_while_it_writes_is_resumed(inputs, tmp_path, capsys, slow_learner, monkeypatch):
    """The body is there by then, and its motion is not."""
    arguments = ["learn", inputs / "meshes.npz", "--rounds", "3", "-o", tmp_path / "new.npz"]

    def killed(*_):
        raise SystemExit(137)

    with monkeypatch.context() as patch:
        patch.setattr(verb, "save_motion", killed)
        with pytest.raises(SystemExit):
            runs(capsys, *arguments)
    assert (tmp_path / "new.npz").is_file() and not (tmp_path / "new-motion.npz").exists()
    runs(capsys, *arguments, "--resume")
    assert (tmp_path / "new-motion.npz").is_file() and not (tmp_path / "new.npz.partial").exists()


@pytest.mark.parametrize(
    ("options", "word"),
    [
        (["--joints", "0"], "--joints"),
        (["--alpha", "-1"], "--alpha"),
        (["--alpha", "nan"], "--alpha"),
        (["--rounds", "0"], "--rounds"),
        (["--hold-out", "1"], "--hold-out"),
        (["--hold-out", "7"], "none of 6 meshes"),
        (["--rate", "0"], "--rate"),
        (["--unit", "furlong"], "furlong"),
        (["--resume", "--overwrite"], "give one of them"),
        (["--pairs", "1:2", "--no-symmetry"], "--pairs"),
        (["--always-symmetric", "--no-symmetry"], "--always-symmetric"),
        (["--pairs", "1-2"], "'1-2'"),
        (["--free-bones", "--pairs", "1:2"], "--free-bones"),
        (["--skeleton", "nowhere.skl"], "nowhere.skl"),
        (["--limits", "limits.npz"], "--limits needs a skeleton"),
        (["--prior", "prior.npz"], "--prior needs a skeleton"),
        (["--floor", "nan"], "--floor"),
        (["--floor", "820"], "--floor is 820 m, and the data are between"),
        (["--fix-joints"], "--fix-joints needs a skeleton"),
        (["--skeleton", "none", "--fix-joints"], "--fix-joints needs a skeleton"),
        (["--skeleton", "human", "--joints", "3"], "omit --joints"),
        (["--skeleton", "human"], "vertices are too few to recognise a person"),
        (["--hold-out", "2", "--motion", "m.bvh"], "m.bvh"),
    ],
)
def test_options_that_are_wrong(inputs, tmp_path, capsys, slow_learner, options, word):
    assert word in fails(capsys, "learn", inputs / "meshes.npz", "-o", tmp_path / "body.npz", *options)
    assert list(tmp_path.iterdir()) == []
    assert "meshes" not in slow_learner


def test_bad_meshes_are_one_line(inputs, tmp_path, capsys, slow_learner):
    with np.load(inputs / "meshes.npz") as file:
        vertices, faces = file["vertices"], file["faces"]
    shuffled = vertices.copy()
    shuffled[2] = shuffled[2][np.random.default_rng(1).permutation(vertices.shape[1])]
    cases = {
        "different vertex order": (shuffled, faces),
        "one mesh only": (vertices[:1], faces),
        "connected components instead of 1": (
            vertices[:, faces].reshape(FRAMES, -1, 3),
            np.arange(faces.size).reshape(-1, 3),
        ),
        "unit='mm'": (1000 * vertices, faces),
    }
    for words, (places, corners) in cases.items():
        np.savez(tmp_path / "bad.npz", vertices=places, faces=corners)
        line = fails(capsys, "learn", tmp_path / "bad.npz", "-o", tmp_path / "body.npz")
        assert words in line
    assert "bad.npz[2]" in _line_of(capsys, tmp_path, shuffled, faces)
    assert "meshes" not in slow_learner


def _line_of(capsys, folder, vertices, faces) -> str:
    np.savez(folder / "bad.npz", vertices=vertices, faces=faces)
    return fails(capsys, "learn", folder / "bad.npz", "-o", folder / "body.npz")


def test_pairs_by_number_and_by_name():
    skeleton = bar().skeleton
    np.testing.assert_array_equal(read_pairs("3:5, 4:6", None), [[3, 5], [4, 6]])
    np.testing.assert_array_equal(read_pairs("joint3:joint5", None), [[3, 5]])
    np.testing.assert_array_equal(read_pairs("low:high", skeleton), [[0, 1]])
    for text, given in (
        ("low:middle", skeleton),
        ("0:2", skeleton),
        ("low:high", None),
        ("1:1", None),
        ("1", None),
    ):
        with pytest.raises(InputError, match="--pairs"):
            read_pairs(text, given)


def test_pairs_are_of_joints_found_from_the_motion():
    assert verb.Learn(("meshes",), Path("body.npz"), pairs="3:5").skeleton_name() == "none"
    assert verb.Learn(("meshes",), Path("body.npz")).skeleton_name() == "automatic"


def test_every_nth_mesh_is_held_out():
    train, held = split_held_out(7, 3)
    np.testing.assert_array_equal(held, [2, 5])
    np.testing.assert_array_equal(train, [0, 1, 3, 4, 6])
    assert split_held_out(7, None)[1].size == 0


@pytest.mark.slow
def test_learning_itself_can_be_stopped(inputs, tmp_path, capsys, monkeypatch):
    """The real loop, broken off after its first round, ends in the same body to the last bit."""
    arguments = ["learn", inputs / "meshes.npz", "--joints", "1", "--rounds", "3", "--hold-out", "3", "-o"]
    told = runs(capsys, *arguments, tmp_path / "whole.npz")
    assert "held out, 2 meshes" in told
    keep = verb.save_checkpoint

    def keep_and_stop(path, checkpoint, header):
        keep(path, checkpoint, header)
        raise KeyboardInterrupt

    monkeypatch.setattr(verb, "save_checkpoint", keep_and_stop)
    with pytest.raises(SystemExit):
        runs(capsys, *arguments, tmp_path / "cut.npz")
    monkeypatch.setattr(verb, "save_checkpoint", keep)
    runs(capsys, *arguments, tmp_path / "cut.npz", "--resume")
    a, b = load_body(tmp_path / "whole.npz"), load_body(tmp_path / "cut.npz")
    np.testing.assert_array_equal(a.vertices, b.vertices)
    np.testing.assert_array_equal(a.skeleton.centres, b.skeleton.centres)
    rotations = [load_motion(tmp_path / f"{name}-motion.npz").poses.rotations for name in ("whole", "cut")]
    np.testing.assert_array_equal(*rotations)
