"""`jaxcap register`: the output, and input that cannot be registered."""

import numpy as np
import pytest
from adapt_scene import FRAMES, make_scene, write_folder, write_scan
from command_line import fails, runs

import jaxcap as jc
from jaxcap.adapt.task import AdaptState, plan_stages
from jaxcap.body.pose import stack_poses
from jaxcap.cli.adapt import adapt as adapt_verb
from jaxcap.io.meshes.mesh import Mesh, write_mesh
from jaxcap.io.meshes.meshes import read_named_meshes
from jaxcap.metrics import scan_to_surface


@pytest.fixture(scope="module")
def scene():
    return make_scene()


@pytest.fixture
def folder(scene, tmp_path):
    """The scans, the actor's own body, and its poses in them."""
    _, actor, poses, _ = scene
    write_folder(tmp_path, scene)
    jc.save_body(tmp_path / "actor.npz", actor)
    jc.save_motion(tmp_path / "poses.npz", stack_poses(poses, 10.0), actor.skeleton)
    return tmp_path


def words(folder, *more) -> tuple:
    return "register", folder / "actor.npz", folder / "*.ply", "-o", folder / "registered.npz", *more


def test_meshes_with_a_body_of_the_person(scene, folder, capsys):
    _, actor, poses, _ = scene
    # the third scan is empty, the fourth one shows something else
    (folder / "scan_0002.ply").write_text("nothing")
    write_scan(folder, 3, np.random.default_rng(0).uniform(-0.4, 0.4, (700, 3)), np.zeros((700, 3)))
    out = runs(capsys, *words(folder, "--motion", folder / "poses.npz"))
    assert f"4 of {FRAMES} scans as meshes of {len(actor.vertices)} vertices" in out
    meshes, names = read_named_meshes(folder / "registered.npz")
    assert [name[-14:-1] for name in names] == [f"scan_000{n}.ply" for n in (0, 1, 4, 5)]
    for row, frame in enumerate((0, 1, 4, 5)):
        truth = np.asarray(jc.pose_body(actor, poses[frame]).vertices)
        away = scan_to_surface(
            np.asarray(truth, float), np.asarray(meshes[row], float), np.asarray(actor.faces)
        )
        assert np.median(away) < 0.001
    with np.load(folder / "registered.npz") as file:
        assert file["frames"].tolist() == [0, 1, 4, 5]
        assert file["seen"].shape == file["distances"].shape == (4, len(actor.vertices))
        assert np.isnan(file["distances"][~file["seen"]]).all()
    line = fails(capsys, *words(folder, "--motion", folder / "poses.npz"))
    assert "already exists; give --overwrite" in line


def test_a_folder_of_meshes(folder, capsys):
    out = folder / "meshes"
    arguments = (
        "register",
        folder / "actor.npz",
        folder / "*.ply",
        "--motion",
        folder / "poses.npz",
        "--as",
        "obj",
    )
    runs(capsys, *arguments, "-o", out)
    assert sorted(path.name for path in out.iterdir()) == [f"registered_000{n}.obj" for n in range(FRAMES)]
    assert len(jc.read_meshes(out)) == FRAMES
    assert "contains registered meshes; give --overwrite" in fails(capsys, *arguments, "-o", out)


def test_what_cannot_be_registered(folder, capsys):
    (folder / "scan_0000.ply").unlink()
    line = fails(capsys, *words(folder, "--motion", folder / "poses.npz"))
    assert f"this motion has {FRAMES} frames, but there are {FRAMES - 1} scans" in line
    assert "--deviation is 0; it must be above 0" in fails(capsys, *words(folder, "--deviation", "0"))
    line = fails(capsys, "register", folder / "body.npz", folder, "-o", ".")
    assert "has no name of its own" in line
    assert "--points is 3; it must be at least 100" in fails(capsys, *words(folder, "--points", "3"))
    write_scan(folder, 0, np.zeros((0, 3)), np.zeros((0, 3)))
    assert "scan_0000.ply" in fails(capsys, *words(folder, "--motion", folder / "poses.npz"))


def test_scans_in_another_unit(scene, folder, capsys):
    _, _, _, clouds = scene
    for number, (points, normals) in enumerate(clouds):
        write_scan(folder, number, 1000 * points, normals)
    for more in ((), ("--motion", folder / "poses.npz")):
        assert "give that unit" in fails(capsys, *words(folder, *more))


def test_learning_from_other_topologies_names_the_file(folder, capsys):
    body = jc.load_body(folder / "body.npz")
    for name, faces in (("a", body.faces), ("b", body.faces[:-1])):
        write_mesh(folder / f"{name}.obj", Mesh(np.asarray(body.vertices), np.asarray(faces), None))
    line = fails(capsys, "learn", folder / "a.obj", folder / "b.obj", "-o", folder / "learned.npz")
    assert "b.obj" in line and "`jaxcap register" in line


@pytest.mark.parametrize("count", [1, FRAMES])
def test_the_body_is_adapted_first(scene, folder, capsys, monkeypatch, count):
    """The stages of `adapt` are tested elsewhere: here they end with the known state. One scan is enough."""
    _, actor, poses, _ = scene
    poses = poses[:count]

    def known(task, state=None, every=0):
        del state, every
        assert task.settings.temporal_weight == 0.0
        done = len(plan_stages(task.settings))
        yield AdaptState(done, actor, 1.1, stack_poses(poses, 10.0), history=(("pose", 1.0),))

    monkeypatch.setattr(adapt_verb, "adapt_body", known)
    scans = folder / "*.ply" if count > 1 else folder / "scan_0000.ply"
    arguments = ("register", folder / "body.npz", scans, "-o", folder / "registered.npz")
    out = runs(capsys, *arguments, "--skip-person-check", "--ordered")
    assert f"{count} of {count} scans as meshes" in out
    np.testing.assert_array_equal(jc.load_body(folder / "registered-body.npz").vertices, actor.vertices)
    assert (folder / "registered-body-motion.npz").is_file()
