"""MHR: vertices against Momentum's equations, derivatives, and what is refused."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from command_line import runs

import jaxcap as jc
from jaxcap.body.body import pose_body
from jaxcap.body.geometric_jacobian import pose_jacobian
from jaxcap.body.pose import rest_pose
from jaxcap.body.retraction import retract
from jaxcap.io.archives.npz import load_body, save_body
from jaxcap.io.body_models.mhr_joints import JOINTS, names_of
from tests.io.body_models.made_mhr import NUM_SHAPES, mhr_arrays, mhr_forward, write_torch


@pytest.fixture
def made(rng, tmp_path):
    arrays = mhr_arrays(rng)
    return write_torch(tmp_path / "mhr_model.pt", arrays), arrays


def num_parameters(arrays):
    return arrays["character_torch.parameter_transform.scaling_parameters"].size - NUM_SHAPES


@pytest.mark.parametrize("size", [0.0, 0.5])
def test_vertices_are_those_of_momentum(made, rng, size):
    path, arrays = made
    parameters = 0.7 * rng.normal(size=(2, num_parameters(arrays)))
    scaling = arrays["character_torch.parameter_transform.scaling_parameters"][: parameters.shape[1]]
    parameters[:, scaling] = size * rng.normal(size=scaling.sum())
    model = jc.io.read_mhr(path, parameters[0])
    assert model.groups == (("betas", 45), ("expression", 72)) and model.family == "MHR"
    motion = jc.io.read_mhr_motion(path, parameters)
    coefficients = rng.normal(size=NUM_SHAPES)
    body = jc.shape_body(model, coefficients)
    found = jc.body.posed_vertices(body, motion.poses)
    for frame in range(2):
        expected = 0.01 * mhr_forward(arrays, parameters[frame], coefficients)
        np.testing.assert_allclose(found[frame], expected, atol=2e-7)
    # the unposed body has the vertices of a pose at rest
    rest = pose_body(body, rest_pose(body.skeleton)).vertices
    np.testing.assert_allclose(rest, body.vertices, atol=1e-12)


def test_derivatives_by_the_pose(made, rng):
    path, arrays = made
    parameters = 0.6 * rng.normal(size=(1, num_parameters(arrays)))
    body = jc.io.read_mhr(path, parameters[0]).template
    pose = jax.tree.map(lambda x: x[0], jc.io.read_mhr_motion(path, parameters).poses)
    skeleton = body.skeleton
    posed = pose_body(body, pose)
    rates = pose_jacobian(skeleton, pose, posed.transforms)
    every = jnp.tile(jnp.eye(3), (len(body.vertices), 1, 1))
    found = body.skin.jacobian(body.vertices, every, skeleton, pose, posed.transforms, rates)
    place = jax.jit(lambda d: pose_body(body, retract(skeleton, pose, d)).vertices)
    step = 1e-6
    for number in range(0, skeleton.num_dofs, 5):
        d = jnp.zeros(skeleton.num_dofs).at[number].set(step)
        np.testing.assert_allclose(found[:, :, number], (place(d) - place(-d)) / (2 * step), atol=1e-7)


def test_a_body_with_the_network_is_kept(made, tmp_path):
    model = jc.io.read_mhr(made[0])
    save_body(tmp_path / "body.npz", model.template)
    poses = jc.body.sample_poses(model.template.skeleton, count=2)
    again = load_body(tmp_path / "body.npz")
    np.testing.assert_allclose(
        jc.body.posed_vertices(again, poses), jc.body.posed_vertices(model.template, poses), atol=1e-6
    )


def test_joints_have_names():
    names = [name for name, _ in JOINTS]
    assert len(names) == 127 and len(set(names)) == 127
    parents = tuple(names.index(above) if above else -1 for _, above in JOINTS)
    assert names_of(parents)[:3] == ("body_world", "root", "l_upleg")
    assert names_of((-1, 0, 0)) == ("joint0", "joint1", "joint2")


def test_what_is_refused(made, rng, tmp_path):
    path, arrays = made
    with pytest.raises(jc.InputError, match="of 30 to 147 finite model parameters"):
        jc.io.read_mhr_motion(path, np.zeros((2, 7)))
    moving = np.zeros((2, num_parameters(arrays)))
    moving[1, -1] = 0.5
    with pytest.raises(jc.InputError, match="the proportions change from frame to frame, by 0.5"):
        jc.io.read_mhr_motion(path, moving)
    bind = "character_torch.linear_blend_skinning.inverse_bind_pose"
    away = arrays[bind].copy()
    away[3, 0] += 1.0
    for changed, message in (
        ({bind: away}, "bound to another pose .* at joint 3"),
        ({"character_torch.skeleton.joint_parents": np.arange(9, dtype=np.int32)}, "one tree of joints"),
        ({"character_torch.mesh.faces": arrays["character_torch.mesh.faces"].astype(float)}, "whole numbers"),
    ):
        with pytest.raises(jc.InputError, match=message):
            jc.io.read_mhr(write_torch(tmp_path / "other.pt", arrays | changed))
    some = {name: values for name, values in arrays.items() if "blend_shape" not in name}
    with pytest.raises(jc.InputError, match="no tensor 'blend_shape.base_shape'"):
        jc.io.read_mhr(write_torch(tmp_path / "other.pt", some))
    (tmp_path / "other.pt").write_bytes(b"no archive")
    with pytest.raises(jc.InputError, match="no TorchScript file"):
        jc.io.read_mhr(tmp_path / "other.pt")
    (tmp_path / "other.pt").write_bytes(path.read_bytes()[:-200])
    with pytest.raises(jc.InputError):
        jc.io.read_mhr(tmp_path / "other.pt")


def test_the_command_line_fits_mhr(made, rng, tmp_path, capsys):
    path, arrays = made
    parameters = 0.2 * rng.normal(size=(2, num_parameters(arrays)))
    scaling = arrays["character_torch.parameter_transform.scaling_parameters"][: parameters.shape[1]]
    parameters[:, scaling] = 0.0
    coefficients = np.concatenate([[1.0, -0.5, 0.3], np.zeros(NUM_SHAPES - 3)])
    meshes = np.array([0.01 * mhr_forward(arrays, p, coefficients) for p in parameters])
    faces = arrays["character_torch.mesh.faces"]
    np.savez(tmp_path / "meshes.npz", vertices=meshes, faces=faces)
    assert "body model: MHR, 45 betas, 72 expression" in runs(capsys, "info", path)
    runs(capsys, "fit", f"{path}:betas=3", tmp_path / "meshes.npz", "-o", tmp_path / "fit.npz")
    with np.load(tmp_path / "fit.npz") as found:
        np.testing.assert_allclose(found["betas"], coefficients[:3], atol=1e-3)
