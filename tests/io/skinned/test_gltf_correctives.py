"""Displacements by the pose as animated morph targets: what another program shows is the posed body."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from command_line import runs
from helpers import chain_body, random_pose

import jaxcap as jc
from jaxcap.body.pose import Motion, stack_poses
from jaxcap.body.skin import CorrectedSkin, RotationMatrixFeatures
from jaxcap.cli import main
from jaxcap.cli.convert import body as verb
from jaxcap.edit.linear_blend import correctives
from jaxcap.io.archives.npz import load_body, save_body, save_motion
from jaxcap.io.gltf.gltf import write_gltf
from jaxcap.io.gltf.gltf_reader import read_gltf_body
from tests.io.skinned.test_gltf import Viewer


@pytest.fixture(scope="module")
def moving():
    """A body with linear blending, displaced by units of low rank, and a motion."""
    rng = np.random.default_rng(0)
    body = chain_body("corrected")
    features = RotationMatrixFeatures().num_features(9)
    layer = np.zeros((5, features))
    # one unit of each of four joints, and one of two joints
    for unit, joint in enumerate((1, 2, 5, 7)):
        layer[unit, 9 * (joint - 1) : 9 * joint] = rng.normal(size=9)
    layer[4, 27:45] = rng.normal(size=18)
    directions = 0.02 * rng.normal(size=(len(body.vertices), 3, 5))
    skin = CorrectedSkin(
        body.skin.skin, RotationMatrixFeatures(), jnp.asarray(directions), jnp.asarray(layer), rectified=False
    )
    low = eqx.tree_at(lambda b: b.skin, body, skin)
    motion = stack_poses([random_pose(body.skeleton, rng, 0.6) for _ in range(5)])
    return {"low rank": low, "all features": body}, Motion(motion.poses, 10.0)


@pytest.mark.parametrize("name", ["low rank", "all features"])
def test_a_viewer_shows_the_posed_body(moving, name, tmp_path):
    body, motion = moving[0][name], moving[1]
    linear = jc.edit.to_linear_blend(body, motion.poses, 1e-4, max_influences=9, correctives=True)
    targets = jc.edit.linear_targets(linear, motion)
    assert linear.error < 1e-4
    # without morph targets the error includes what is lost
    plain = jc.edit.to_linear_blend(body, motion.poses, 1e-4, max_influences=9)
    assert plain.error > 0.01 and jc.edit.linear_targets(plain, motion) is None
    write_gltf(tmp_path / "body.glb", linear.body, jc.edit.linear_motion(linear, motion), targets)
    viewer = Viewer(tmp_path / "body.glb")
    for frame in range(5):
        expected = jc.pose_body(body, motion[frame]).vertices
        np.testing.assert_allclose(viewer.vertices(frame / 10.0), expected, atol=1e-4)
    if name == "low rank":
        names = viewer.file.meshes[0].extras["targetNames"]
        assert names == ["spine 1", "chest 1", "hand 1", "neck 1", "corrective 1"]
    # without a motion all weights are zero
    write_gltf(tmp_path / "rest.glb", linear.body, targets=jc.edit.linear_targets(linear))
    np.testing.assert_allclose(Viewer(tmp_path / "rest.glb").vertices(0.0), body.vertices, atol=1e-6)


def test_the_command_line_writes_targets_and_says_what_usd_loses(moving, tmp_path, capsys):
    body, motion = moving[0]["low rank"], moving[1]
    save_body(tmp_path / "body.npz", body)
    again = load_body(tmp_path / "body.npz")
    assert not again.skin.rectified
    np.testing.assert_array_equal(again.skin.layer, body.skin.layer)
    save_motion(tmp_path / "motion.npz", motion, body.skeleton)
    options = ("--motion", tmp_path / "motion.npz", "--influences", "9")
    printed = runs(capsys, "convert", tmp_path / "body.npz", tmp_path / "body.glb", *options)
    assert "5 morph targets; largest error" in printed
    expected = jc.pose_body(body, motion[3]).vertices
    np.testing.assert_allclose(Viewer(tmp_path / "body.glb").vertices(0.3), expected, atol=1e-4)
    # the reader keeps the motion of the joints, and warns of shape keys
    with pytest.warns(UserWarning, match="shape keys"):
        read = read_gltf_body(tmp_path / "body.glb")[1]
    np.testing.assert_allclose(
        np.abs(np.sum(np.asarray(read.poses.rotations) * np.asarray(motion.poses.rotations), 2)),
        1.0,
        atol=1e-6,
    )


@pytest.mark.parametrize(
    ("most", "words"), [(256, "nothing moves the morph targets"), (2, "the 2 with the largest")]
)
def test_targets_that_are_not_what_they_seem_have_a_warning(
    moving, tmp_path, capsys, monkeypatch, most, words
):
    for module in (correctives, verb):
        monkeypatch.setattr(module, "MAX_UNITS", most)
    save_body(tmp_path / "body.npz", moving[0]["low rank"])
    capsys.readouterr()
    main(["convert", str(tmp_path / "body.npz"), str(tmp_path / "body.glb"), "--influences", "9"])
    assert words in capsys.readouterr().err


def test_targets_that_do_not_fit_are_refused(moving, tmp_path):
    body, motion = moving[0]["low rank"], moving[1]
    linear = jc.edit.to_linear_blend(body, motion.poses, 1e-4, max_influences=9, correctives=True)
    targets = jc.edit.linear_targets(linear, motion)
    moved = jc.edit.linear_motion(linear, motion)
    for wrong, sentence in (
        (targets._replace(weights=targets.weights[:3]), r"have the shape \(3, 5\); expected \(5, 5\)"),
        (targets._replace(displacements=targets.displacements[:, :7]), "5 of 7 vertices, with 5 names"),
        (targets._replace(weights=np.nan * targets.weights), "not finite"),
    ):
        with pytest.raises(jc.InputError, match=sentence):
            write_gltf(tmp_path / "no.glb", linear.body, moved, wrong)
    assert not (tmp_path / "no.glb").exists()
