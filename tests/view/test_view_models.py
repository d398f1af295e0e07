"""Motions of body models in a window, and models that are read once."""

import numpy as np
import pytest

from jaxcap.cli.body_models import load_model
from jaxcap.cli.view import body_of_motion
from jaxcap.errors import InputError
from jaxcap.io.skeletons.amass import read_amass, write_amass
from jaxcap.view.load import load
from tests.io.body_models.made_smpl import smpl_arrays, smpl_forward


def test_a_motion_of_amass_moves_its_model_in_its_shape(tmp_path):
    arrays, rng = smpl_arrays(vertices=40), np.random.default_rng(3)
    model = tmp_path / "smpl.npz"
    np.savez(model, **arrays)
    betas, trans, poses = rng.normal(size=6), 0.1 * rng.normal(size=(2, 3)), 0.2 * rng.normal(size=(2, 72))
    parameters = {
        "trans": trans, "poses": poses, "mocap_framerate": 30.0, "gender": "neutral", "up_axis": "y"
    }  # fmt: skip
    np.savez(tmp_path / "amass.npz", betas=betas, **parameters)
    body = load_model(str(model)).template
    files = [str(tmp_path / "amass.npz")]
    (take,) = load(files, [(str(model), body)], shape=body_of_motion).takes
    wanted = [smpl_forward(arrays, betas, p, t)[0] for p, t in zip(poses, trans, strict=True)]
    found = [take.motion.frame(number).vertices for number in range(2)]
    np.testing.assert_allclose(found, wanted, atol=1e-5)
    # people of several shapes cannot be one body
    np.savez(tmp_path / "people.npz", betas=np.stack([betas, -betas]), **parameters)
    with pytest.raises(InputError, match="every frame has a shape of its own"):
        load([str(tmp_path / "people.npz")], [(str(model), body)], shape=body_of_motion)
    # without the model there are the bones, if the file has them
    with pytest.raises(InputError, match="--body"):
        load(files)
    skeleton, motion = read_amass(tmp_path / "amass.npz", body.skeleton)
    write_amass(tmp_path / "with_bones.npz", skeleton, motion, {"betas": betas})
    shown = load([str(tmp_path / "with_bones.npz")])
    assert shown.takes[0].motion.body is None
    assert "give its body model by --body" in shown.notes[0]


def test_a_model_is_read_once(tmp_path):
    np.savez(tmp_path / "smpl.npz", **smpl_arrays(vertices=40))
    spec = str(tmp_path / "smpl.npz")
    first = load_model(spec)
    assert load_model(spec) is first
    assert load_model(f"{spec}:betas=2") is not first
    np.savez(tmp_path / "smpl.npz", **smpl_arrays(vertices=41))
    assert len(load_model(spec).template.vertices) == 41
