"""SKEL: vertices and joints against the paper's transforms, and what is refused."""

import pickle

import numpy as np
import pytest
import scipy.sparse as sparse
from command_line import runs

import jaxcap as jc
from jaxcap.body.kinematics import joint_paths
from tests.io.body_models.made_skel import skel_arrays, skel_forward


def write(path, arrays):
    """Write a file as SKEL's authors do: a pickle with sparse matrices."""
    kinds = {"J_regressor_osim": sparse.coo_matrix, "skin_weights": sparse.coo_matrix}
    content = {name: kinds.get(name, lambda x: x)(values) for name, values in arrays.items()}
    path.write_bytes(pickle.dumps(content, protocol=2))
    return path


@pytest.fixture
def made(rng, tmp_path):
    arrays = skel_arrays(rng)
    return write(tmp_path / "skel_male.pkl", arrays), arrays


def test_vertices_and_joints_are_those_of_the_paper(made, rng):
    path, arrays = made
    model = jc.io.read_skel(path)
    assert model.groups == (("betas", 10),) and model.family == "SKEL"
    angles, trans, betas = 0.6 * rng.normal(size=(3, 46)), rng.normal(size=(3, 3)), rng.normal(size=10)
    angles[0] = 0.0
    body = jc.shape_body(model, betas)
    poses = jc.io.read_skel_motion(path, angles, trans, betas).poses
    vertices, joints = jc.body.posed_vertices(body, poses), joint_paths(body.skeleton, poses)
    for frame in range(3):
        expected = skel_forward(arrays, angles[frame], trans[frame], betas)
        np.testing.assert_allclose(vertices[frame], expected[0], atol=1e-12)
        np.testing.assert_allclose(joints[frame], expected[1], atol=1e-12)


def test_joints_for_tracking_have_the_axes_of_the_mean_shape(made, rng):
    path, _ = made
    skeleton = jc.io.read_skel(path, joints="tracking").template.skeleton
    assert skeleton.kinds.count("revolute") == 12 and skeleton.kinds.count("universal") == 2
    angles = 0.5 * rng.normal(size=(1, 46))
    poses = jc.io.read_skel_motion(path, angles, np.zeros((1, 3))).poses
    for joint, kind in enumerate(skeleton.kinds):
        if kind == "revolute":
            turn = np.asarray(poses.rotations[0, joint, 1:])
            np.testing.assert_allclose(np.cross(turn, skeleton.axes[joint, 0]), 0.0, atol=1e-6)


def test_the_command_line_fits_skel(made, rng, tmp_path, capsys):
    path, arrays = made
    betas = np.array([1.0, -0.5, 0.3])
    meshes = [
        skel_forward(arrays, 0.1 * rng.normal(size=46), rng.normal(size=3), np.pad(betas, (0, 7)))[0]
        for _ in range(3)
    ]
    np.savez(tmp_path / "meshes.npz", vertices=meshes, faces=arrays["skin_template_f"])
    assert "body model: SKEL, 10 betas" in runs(capsys, "info", path)
    runs(capsys, "fit", f"{path}:betas=3", tmp_path / "meshes.npz", "-o", tmp_path / "fit.npz")
    with np.load(tmp_path / "fit.npz") as found:
        assert str(found["gender"]) == "male"
        # the joints of a fit do not slide
        np.testing.assert_allclose(found["betas"], betas, atol=0.3)


def test_what_is_refused(made, tmp_path):
    path, arrays = made
    with pytest.raises(jc.InputError, match="2 frames of 45 angles and 2 frames"):
        jc.io.read_skel_motion(path, np.zeros((2, 45)), np.zeros((2, 3)))
    with pytest.raises(jc.InputError, match="at most 10 coefficients"):
        jc.io.read_skel_motion(path, np.zeros((2, 46)), np.zeros((2, 3)), np.zeros(11))
    for changed, message in (
        ({"version": "1.0"}, "the version of this file of SKEL is 1.0; expected 1.1.1"),
        ({"osim_kintree_table": np.array([[-1, 0], [0, 1]])}, "the model has 2 joints; expected the 24"),
        ({"posedirs": np.zeros((60, 3, 9))}, "posedirs"),
        ({"skin_weights": np.zeros((60, 24))}, "sums to 0"),
    ):
        with pytest.raises(jc.InputError, match=message):
            jc.io.read_skel(write(tmp_path / "other.pkl", arrays | changed))
