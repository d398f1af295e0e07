"""Bodies written in SMPL's format, against the equations of the papers in NumPy."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from command_line import fails, runs
from helpers import chain_body

import jaxcap as jc
from jaxcap.body.skin import CorrectedSkin
from jaxcap.geometry import rotation
from jaxcap.io.archives.npz import save_body
from tests.io.body_models.made_smpl import smpl_arrays, smpl_forward


def template(tmp_path, quaternions: bool):
    """A body with the joints of SMPL and displacements of low rank."""
    np.savez(tmp_path / "made.npz", **smpl_arrays(quaternions=quaternions))
    body = jc.read_body_model(tmp_path / "made.npz").template
    rng = np.random.default_rng(1)
    layer = rng.normal(size=(7, body.skin.directions.shape[2]))
    directions = 0.01 * rng.normal(size=(len(body.vertices), 3, 7))
    skin = CorrectedSkin(
        body.skin.skin, body.skin.features, jnp.asarray(directions), jnp.asarray(layer), rectified=False
    )
    return eqx.tree_at(lambda b: b.skin, body, skin)


@pytest.mark.parametrize("quaternions", [False, True])
def test_the_equations_of_the_papers_pose_a_written_body(tmp_path, rng, quaternions):
    body = template(tmp_path, quaternions)
    jc.io.write_body_model(tmp_path / "written.npz", body)
    with np.load(tmp_path / "written.npz") as file:
        arrays = dict(file)
    np.testing.assert_allclose(arrays["J_regressor"].sum(1), 1.0, atol=1e-9)
    turns, trans = 0.6 * rng.normal(size=(24, 3)), rng.normal(size=3)
    if quaternions:
        # the last direction of STAR depends on the shape
        arrays["posedirs"] = np.concatenate([arrays["posedirs"], np.zeros((60, 3, 1))], 2)
    vertices, centres = smpl_forward(arrays, np.zeros(10), turns, trans)
    pose = jc.Pose(
        jnp.zeros((24, 3)).at[0].set(trans), jax.vmap(rotation.exp)(jnp.asarray(turns)), jnp.ones(())
    )
    posed = jc.pose_body(body, pose)
    np.testing.assert_allclose(posed.vertices, vertices, atol=1e-9)
    np.testing.assert_allclose(posed.joints, centres, atol=1e-9)
    # and our own reader
    again = jc.read_body_model(tmp_path / "written.npz")
    assert again.family == "" and again.template.skeleton.names == body.skeleton.names
    np.testing.assert_allclose(jc.pose_body(again.template, pose).vertices, posed.vertices, atol=1e-9)


def test_other_bodies_are_refused(tmp_path, capsys):
    for skin, sentence in (
        ("linear", "the joint 'slide' translates"),
        ("swing_twist", "SwingTwistSkin; learn the body with --skin lbs"),
        ("corrected_swing_twist", "SwingTwistSkin; learn the body with --skin lbs"),
    ):
        with pytest.raises(jc.InputError, match=sentence):
            jc.io.write_body_model(tmp_path / "no.npz", chain_body(skin))
    save_body(tmp_path / "body.npz", chain_body("swing_twist"))
    said = fails(capsys, "convert", tmp_path / "body.npz", tmp_path / "no.npz", "--as", "smpl")
    assert "SwingTwistSkin" in said and not (tmp_path / "no.npz").exists()
    # kinds of joints that do not translate become ball joints
    human = jc.human(resolution="low")
    save_body(tmp_path / "human.npz", human)
    runs(capsys, "convert", tmp_path / "human.npz", tmp_path / "smpl.npz", "--as", "smpl")
    assert jc.read_body_model(tmp_path / "smpl.npz").template.skeleton.names == human.skeleton.names
