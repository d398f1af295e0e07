"""Body models on the command line: info, fit, convert, track, and what does not fit."""

import numpy as np
import pytest
from command_line import fails, runs

from jaxcap.cli import main
from jaxcap.cli.body_models import load_shaped_body
from jaxcap.io.archives.npz import load_body
from jaxcap.io.meshes.meshes import save_meshes
from jaxcap.io.registry import read_marker_file, read_skinned
from jaxcap.io.skeletons.amass import read_amass, read_amass_shape
from jaxcap.observe.meshes import MeshSequence
from tests.io.body_models.made_smpl import smpl_arrays, smpl_forward

FRAMES = 3


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A model, meshes of one person that it made, and their parameters in AMASS's format."""
    folder, rng = tmp_path_factory.mktemp("models"), np.random.default_rng(5)
    arrays = smpl_arrays(vertices=80)
    np.savez(folder / "smpl_neutral.npz", **arrays)
    betas, trans = rng.normal(size=6), 0.1 * rng.normal(size=(FRAMES, 3))
    poses = 0.15 * rng.normal(size=(FRAMES, 72))
    # neither y nor z is clearly the vertical, which the file does not state
    poses[:, 0] += np.pi / 4
    meshes = np.array([smpl_forward(arrays, betas, p, t)[0] for p, t in zip(poses, trans, strict=True)])
    save_meshes(folder / "meshes.npz", MeshSequence(meshes, arrays["f"].astype(int), 30.0))
    np.savez(
        folder / "amass.npz", betas=betas, poses=poses, trans=trans, gender="neutral", mocap_framerate=30.0
    )
    return folder, arrays, betas, meshes


def test_a_model_is_described(folder, capsys):
    printed = runs(capsys, "info", folder[0] / "smpl_neutral.npz")
    assert "body model: SMPL, 6 betas" in printed
    assert "80 vertices" in printed
    assert "jaxcap fit" in printed


@pytest.mark.parametrize("each", [(), ("--each-person",)])
def test_parameters_of_meshes_are_written_as_amass_has_them(folder, each, tmp_path, capsys):
    folder, arrays, betas, meshes = folder
    runs(capsys, "fit", folder / "smpl_neutral.npz", folder / "meshes.npz", "-o", tmp_path / "fit.npz", *each)
    with np.load(tmp_path / "fit.npz") as file:
        found = dict(file)
    assert ("skeleton.names" in found) == (not each)
    assert str(found["gender"]) == "neutral"
    rows = found["betas"] if each else np.tile(found["betas"], (FRAMES, 1))
    np.testing.assert_allclose(rows, np.tile(betas, (FRAMES, 1)), atol=2e-3)
    again = [smpl_forward(arrays, rows[k], found["poses"][k], found["trans"][k])[0] for k in range(FRAMES)]
    np.testing.assert_allclose(again, meshes, atol=2e-5)
    assert str(found["up_axis"]) == "y"


def test_a_motion_of_amass_moves_its_model_in_its_shape(folder, tmp_path, capsys):
    folder, arrays, betas, _ = folder
    spec = f"{folder / 'smpl_neutral.npz'}:full"
    runs(
        capsys, "convert", folder / "amass.npz", tmp_path / "m.glb", "--body", spec, "--up", "y", "--influences", "24"
    )  # fmt: skip
    # the displacements by the pose are shape keys there, which are not read back
    with pytest.warns(UserWarning, match="shape keys"):
        body, motion = read_skinned(tmp_path / "m.glb")
    assert motion.num_frames == FRAMES
    shaped = arrays["v_template"] + arrays["shapedirs"] @ betas
    np.testing.assert_allclose(body.vertices, shaped, atol=1e-5)
    # the shape stays with the motion
    runs(
        capsys, "convert", folder / "amass.npz", tmp_path / "again.npz", "--as", "amass", "--body", spec
    )  # fmt: skip
    shape, gender = read_amass_shape(tmp_path / "again.npz")
    np.testing.assert_array_equal(shape["betas"], betas)
    assert gender == "neutral"
    skeleton, _ = read_amass(tmp_path / "again.npz")
    np.testing.assert_allclose(skeleton.centres, arrays["J_regressor"] @ shaped, atol=1e-6)


@pytest.mark.parametrize("each", [(), ("--each-person",)])
def test_vertices_in_another_order_are_doubted(folder, each, tmp_path, capsys):
    folder, arrays, _, meshes = folder
    order = np.r_[10:0:-1, 0, 11:80]
    save_meshes(tmp_path / "other.npz", MeshSequence(meshes[:, order], arrays["f"].astype(int), 30.0))
    main(["fit", f"{folder}/smpl_neutral.npz", f"{tmp_path}/other.npz", "-o", f"{tmp_path}/fit.npz", *each])
    said = capsys.readouterr().err
    assert "check that the vertices have the order of those of" in said
    assert ("give --each-person" in said) == (not each)


def test_a_template_becomes_a_body(folder, tmp_path, capsys):
    folder, arrays, *_ = folder
    runs(capsys, "convert", folder / "smpl_neutral.npz", tmp_path / "body.npz", "--as", "body")
    body = load_body(tmp_path / "body.npz")
    np.testing.assert_allclose(body.vertices, arrays["v_template"], atol=1e-6)
    # hands are fixed unless asked for
    assert body.skeleton.kinds[-1] == "fixed"


def test_a_fit_is_read_with_its_model_again(tmp_path, capsys):
    """Also of a model with expressions, whose folder states the gender."""
    (tmp_path / "female").mkdir()
    arrays = smpl_arrays(55, vertices=90, directions=20)
    model = tmp_path / "female" / "model.npz"
    np.savez(model, **arrays)
    rng = np.random.default_rng(2)
    poses = 0.1 * rng.normal(size=(1, 165))
    mesh = smpl_forward(arrays, 0.5 * rng.normal(size=20), poses[0], np.zeros(3))[0]
    save_meshes(tmp_path / "mesh.npz", MeshSequence(mesh[None], arrays["f"].astype(int), 30.0))
    # a motion without hands may be of SMPL, whose shapes are others
    np.savez(tmp_path / "trunk.npz", betas=np.ones(10), poses=poses[:, :66], trans=np.zeros((1, 3)))
    load_shaped_body(str(model), tmp_path / "trunk.npz")
    assert "its betas are read as those of SMPL-X" in capsys.readouterr().err
    spec = f"{model}:expression=10"
    runs(capsys, "fit", spec, tmp_path / "mesh.npz", "-o", tmp_path / "fit.npz")
    shape, gender = read_amass_shape(tmp_path / "fit.npz")
    assert (len(shape["betas"]), len(shape["expression"]), gender) == (10, 10, "female")
    runs(capsys, "convert", tmp_path / "fit.npz", tmp_path / "fit.bvh", "--body", model)
    runs(
        capsys, "evaluate", model, tmp_path / "fit.npz", tmp_path / "mesh.npz", "-o", tmp_path / "report.json"
    )
    assert "10 expression" in runs(capsys, "info", spec)


def test_what_does_not_fit_is_told(folder, tmp_path, capsys):
    folder = folder[0]
    model = folder / "smpl_neutral.npz"
    assert "'hands' is not an option of a body model" in fails(
        capsys, "fit", f"{model}:hands", folder / "meshes.npz", "-o", tmp_path / "f.npz"
    )
    assert "--each-person is for body models" in fails(
        capsys, "fit", "human", folder / "meshes.npz", "-o", tmp_path / "f.npz", "--each-person"
    )
    assert "--each-person and --report were both given" in fails(
        capsys, "fit", model, folder / "meshes.npz", "-o", tmp_path / "f.npz", "--each-person", "--report", tmp_path
    )  # fmt: skip
    assert "--body and --motion were both given" in fails(
        capsys, "convert", folder / "amass.npz", tmp_path / "m.glb", "--body", model, "--motion", folder / "amass.npz"
    )  # fmt: skip
    people = dict(np.load(folder / "amass.npz")) | {"betas": np.eye(FRAMES, 6)}
    np.savez(tmp_path / "people.npz", **people)
    line = fails(capsys, "convert", tmp_path / "people.npz", tmp_path / "m.glb", "--body", model)
    assert "every frame has a shape of its own" in line
    tilted = dict(np.load(folder / "amass.npz")) | {"up_axis": "x"}
    np.savez(tmp_path / "tilted.npz", **tilted)
    line = fails(capsys, "convert", tmp_path / "tilted.npz", tmp_path / "m.glb", "--body", model)
    assert "'up_axis' is x; expected y or z" in line
    longer = dict(np.load(folder / "amass.npz")) | {"betas": np.ones(16)}
    np.savez(tmp_path / "longer.npz", **longer)
    main([str(word) for word in ("convert", tmp_path / "longer.npz", tmp_path / "l.npz", "--body", model)])
    assert "10 of 16 betas are left out, as smpl_neutral.npz has 6" in capsys.readouterr().err
    male = dict(np.load(folder / "amass.npz")) | {"gender": "male"}
    np.savez(tmp_path / "male.npz", **male)
    main([str(word) for word in ("convert", tmp_path / "male.npz", tmp_path / "m.npz", "--body", model)])
    assert "belongs to the male model, and smpl_neutral.npz is the neutral one" in capsys.readouterr().err


def test_parameters_of_another_program_are_described_and_converted(folder, tmp_path, capsys):
    """A file without a rate, with the parts of `smplx`, and more coefficients than the model has, which are zeros."""
    folder, arrays, betas, _ = folder
    amass = dict(np.load(folder / "amass.npz"))
    poses, trans = amass["poses"], amass["trans"]
    source, out = tmp_path / "smplx.npz", tmp_path / "m.csv"
    np.savez(
        source,
        global_orient=poses[:, :3],
        body_pose=poses[:, 3:],
        transl=trans,
        betas=np.tile([*betas, 0, 0], (FRAMES, 1)),
    )
    printed = runs(capsys, "info", source)
    assert "motion in AMASS format: 3 frames, no rate, poses of 24 joints (SMPL), 8 betas;" in printed
    to = ["convert", source, out, "--body", folder / "smpl_neutral.npz", "--vertices", 7, "--up", "y"]
    assert "give --rate in `jaxcap convert`" in fails(capsys, *to)
    assert "at 25 frames per second" in runs(capsys, *to, "--rate", 25)
    wanted = [smpl_forward(arrays, betas, p, t)[0][7] for p, t in zip(poses, trans, strict=True)]
    found = read_marker_file(out).frames.positions[:, -1]
    np.testing.assert_allclose(found, wanted, atol=1e-5)
