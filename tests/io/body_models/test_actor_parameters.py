"""The parameters of a body model of an adapted person."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from command_line import fails

import jaxcap as jc
from jaxcap.adapt.task import AdaptState
from jaxcap.cli.adapt.parameters import write_actor_parameters
from jaxcap.cli.body_models import load_model
from jaxcap.io.skeletons.amass import read_amass_shape
from tests.io.body_models.made_smpl import smpl_arrays, smpl_forward


def test_free_vertices_leave_a_residual(tmp_path, capsys):
    arrays, rng = smpl_arrays(5, vertices=120), np.random.default_rng(1)
    spec = str(tmp_path / "flame_neutral.npz")
    np.savez(spec, **arrays)
    betas = 0.5 * rng.normal(size=6)
    person = jc.shape_body(load_model(spec), betas=betas)
    motion = jc.Motion(jc.body.sample_poses(person.skeleton, count=2), 30.0)
    free = 0.001 * rng.normal(size=person.vertices.shape)
    state = AdaptState(
        9, eqx.tree_at(lambda b: b.vertices, person, person.vertices + jnp.asarray(free)), 1.0, motion
    )
    write_actor_parameters(tmp_path / "p.npz", spec, None, state)
    printed = capsys.readouterr().out
    residual = float(printed.split("free vertices leave ")[1].split(" mm")[0])
    # what six coefficients and a pose cannot follow of 1 mm along each axis, 1.6 mm on average
    assert 1.2 < residual < 1.7
    np.testing.assert_allclose(read_amass_shape(tmp_path / "p.npz")[0]["betas"], betas, atol=0.01)
    with np.load(tmp_path / "p.npz") as file:
        found = dict(file)
    assert str(found["up_axis"]) == "z"
    turned = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
    for k in range(2):
        shown = smpl_forward(arrays, found["betas"], found["poses"][k], found["trans"][k])[0] @ turned
        wanted = np.asarray(jc.body.posed_vertices(state.body, motion.poses))[k]
        assert np.linalg.norm(shown - wanted, axis=1).mean() < 0.0018


def test_parameters_are_those_of_a_model(tmp_path, capsys):
    assert "--parameters is for body models" in fails(
        capsys, "adapt", "human", tmp_path / "*.ply", "-o", tmp_path / "a.npz", "--parameters", tmp_path / "p.npz"
    )  # fmt: skip
    assert "--deviations is for parameters" in fails(
        capsys, "adapt", "human", tmp_path / "*.ply", "-o", tmp_path / "a.npz", "--deviations"
    )
