"""`jaxcap convert --to`: motions of SMPL for SMPL-H, which has SMPL's surface, and for other bodies; faults are sentences."""

import numpy as np
import pytest
from command_line import fails, runs

import jaxcap as jc
from jaxcap.body.people.walk_and_wave import walk_and_wave
from jaxcap.io.registry import read_motion
from jaxcap.io.skeletons.parameters.joints import SMPL_PARENTS
from tests.io.body_models.made_smpl import smpl_arrays, smpl_forward

#: joints of the trunk and limbs, which both models have, and the first joints of the fingers in SMPL-H
TRUNK, FINGERS = 22, (22, 37)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """SMPL and SMPL-H of the same surface, a motion of SMPL whose hands do not bend, a small human and its walk."""
    folder, rng = tmp_path_factory.mktemp("convert"), np.random.default_rng(5)
    smpl = smpl_arrays(vertices=80)
    smpl["posedirs"] *= 0
    parents = SMPL_PARENTS[52]
    weights, regressor = np.zeros((80, 52)), np.zeros((52, 80))
    weights[:, :TRUNK], regressor[:TRUNK] = smpl["weights"][:, :TRUNK], smpl["J_regressor"][:TRUNK]
    for own, finger in zip((22, 23), FINGERS, strict=True):
        weights[:, finger] = smpl["weights"][:, own]
    # a finger of no weight at the wrist
    regressor[TRUNK:] = smpl["J_regressor"][22]
    smplh = {
        **smpl,
        "posedirs": np.zeros((80, 3, 9 * 51)),
        "weights": weights,
        "J_regressor": regressor,
        "kintree_table": np.array([[2**32 - 1, *parents[1:]], range(52)], dtype=np.uint32),
    }
    np.savez(folder / "smpl_female.npz", **smpl)
    np.savez(folder / "smplh_female.npz", **smplh)
    betas, trans, poses = rng.normal(size=6), 0.1 * rng.normal(size=(3, 3)), 0.15 * rng.normal(size=(3, 72))
    poses[:, 66:] = 0
    # neither y nor z is clearly the vertical, which the file does not state
    poses[:, 0] += np.pi / 4
    np.savez(
        folder / "amass.npz", betas=betas, poses=poses, trans=trans, gender="female", mocap_framerate=30.0
    )
    body = jc.human(resolution="low", joints="tracking", sex="female")
    jc.save_body(folder / "woman.npz", body)
    jc.save_motion(folder / "walk.npz", walk_and_wave(body.skeleton, seconds=0.1), body.skeleton)
    return folder


def test_a_motion_of_smpl_becomes_one_of_smplh_with_its_shape(folder, tmp_path, capsys):
    """The surfaces are the same, vertex by vertex, so that AMASS's parameters are too."""
    out = tmp_path / "h.npz"
    told = runs(
        capsys, "convert", folder / "amass.npz", out, "--body", folder / "smpl_female.npz",
        "--to", folder / "smplh_female.npz",
    )  # fmt: skip
    assert "distance of the surfaces: mean 0.0" in told
    with np.load(out) as file, np.load(folder / "amass.npz") as given:
        assert str(file["gender"]) == "female"
        np.testing.assert_allclose(file["betas"], given["betas"], atol=5e-3)
        with np.load(folder / "smpl_female.npz") as model:
            arrays = dict(model)
        for frame in range(3):
            # the trunk's poses move SMPL as those of its own motion; the hands do not bend
            turns = np.append(file["poses"][frame][: 3 * TRUNK], np.zeros(6))
            found = smpl_forward(arrays, file["betas"], turns, file["trans"][frame])[0]
            wanted = smpl_forward(arrays, given["betas"], given["poses"][frame], given["trans"][frame])[0]
            np.testing.assert_allclose(found, wanted, atol=2e-3)


def test_a_human_model_writes_its_body_next_to_the_motion(folder, tmp_path, capsys):
    """A woman of the same triangles: the model of people has her shape."""
    out = tmp_path / "out.npz"
    told = runs(
        capsys, "convert", folder / "walk.npz", out, "--body", folder / "woman.npz", "--to", "human:low"
    )
    assert f"{tmp_path / 'out_body.npz'}: the body of the motion" in told
    body, woman = jc.load_body(tmp_path / "out_body.npz"), jc.load_body(folder / "woman.npz")
    assert np.linalg.norm(np.asarray(body.vertices - woman.vertices), axis=1).mean() < 3e-3
    motion = read_motion(out)[1]
    assert len(motion) == 3
    said = fails(capsys, "convert", folder / "walk.npz", tmp_path / "out.bvh", "--body", folder / "woman.npz", "--to", "human:low")  # fmt: skip
    assert "out_body.npz: this file already exists" in said


def test_a_body_alone_is_at_rest_and_a_skeleton_alone_goes_by_its_joints(folder, tmp_path, capsys):
    woman = folder / "woman.npz"
    assert "mean 0.0" in runs(capsys, "convert", woman, tmp_path / "still.glb", "--to", woman)
    told = runs(capsys, "convert", folder / "walk.npz", tmp_path / "walk.bvh", "--to", "human:low,height=1.8")
    assert "by the names of joints" in told
    assert len(read_motion(tmp_path / "walk.bvh")[1]) == 3


@pytest.mark.parametrize(
    ("source", "target", "options", "said"),
    [
        ("walk.npz", "a.trc", ("--to", "human"), "not written as '.trc' files"),
        ("walk.npz", "a.npz", ("--to", "gone.npz"), "gone.npz: there is no such file"),
        ("gone.npz", "a.npz", ("--to", "human"), "gone.npz: there is no such file"),
        ("walk.npz", "a.npz", ("--to", "human:huge"), "'huge' is not an option"),
        ("walk.npz", "a.npz", ("--to", "human", "--as", "amass"), "--as and --to were both given"),
        ("walk.npz", "a.npz", ("--to", "human", "--up", "z"), "--up is for"),
        ("walk.npz", "a.npz", ("--to", "walk.npz"), "walk.npz"),
    ],
)
def test_wrong_input_is_a_sentence(folder, tmp_path, capsys, source, target, options, said):
    words = [folder / word if (folder / str(word)).exists() else word for word in options]
    assert said in fails(capsys, "convert", folder / source, tmp_path / target, *words)
