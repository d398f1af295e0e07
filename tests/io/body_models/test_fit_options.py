"""`jaxcap fit` with expressions that change from mesh to mesh, and with deviations."""

import numpy as np
import pytest
from command_line import fails, runs

from jaxcap.io.meshes.meshes import save_meshes
from jaxcap.io.skeletons.amass import read_amass_deviations, read_amass_shape
from jaxcap.observe.meshes import MeshSequence
from tests.io.body_models.made_smpl import smpl_arrays, smpl_forward

FRAMES = 3


def coefficients(betas, expressions) -> np.ndarray:
    """All coefficients of a file: unused ones are zero."""
    return np.concatenate([betas, np.zeros((len(betas), 290)), expressions], 1)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A head model, and meshes of one person with another expression in each, and small errors."""
    folder, rng = tmp_path_factory.mktemp("models"), np.random.default_rng(5)
    # FLAME has 300 directions of shapes, and those of expressions behind them
    arrays = smpl_arrays(5, vertices=120, directions=310)
    np.savez(folder / "flame_neutral.npz", **arrays)
    betas = np.tile(0.7 * rng.normal(size=10), (FRAMES, 1))
    expressions = 0.7 * rng.normal(size=(FRAMES, 10))
    poses, trans = 0.1 * rng.normal(size=(FRAMES, 15)), 0.2 * rng.normal(size=(FRAMES, 3))
    z = coefficients(betas, expressions)
    meshes = np.array([smpl_forward(arrays, *each)[0] for each in zip(z, poses, trans, strict=True)])
    save_meshes(folder / "meshes.npz", MeshSequence(meshes, arrays["f"].astype(int), 30.0))
    return folder, arrays, betas[0], expressions, meshes


def test_one_person_has_other_expressions(folder, tmp_path, capsys):
    folder, arrays, betas, expressions, meshes = folder
    files = folder / "flame_neutral.npz", folder / "meshes.npz", "-o", tmp_path / "fit.npz"
    assert "each with an expression of its own" in runs(capsys, "fit", *files, "--expressions")
    with np.load(tmp_path / "fit.npz") as file:
        found = dict(file)
    np.testing.assert_allclose(found["betas"], betas, atol=5e-3)
    np.testing.assert_allclose(found["expression"], expressions, atol=5e-3)
    z = coefficients(np.tile(found["betas"], (FRAMES, 1)), found["expression"])
    again = [smpl_forward(arrays, z[k], found["poses"][k], found["trans"][k])[0] for k in range(FRAMES)]
    np.testing.assert_allclose(again, meshes, atol=1e-4)
    # the shape is that of one person
    with pytest.warns(UserWarning, match="the expression changes from frame to frame; it is left out"):
        assert list(read_amass_shape(tmp_path / "fit.npz")[0]) == ["betas"]
    assert "--expressions is for one person" in fails(
        capsys, "fit", *files, "--expressions", "--each-person", "--overwrite"
    )


def test_deviations_are_in_the_file(folder, tmp_path, capsys):
    folder, *_ = folder
    files = folder / "flame_neutral.npz", folder / "meshes.npz", "-o", tmp_path / "fit.npz"
    runs(capsys, "fit", *files, "--deviations", "--each-person")
    groups, joints = read_amass_deviations(tmp_path / "fit.npz")
    assert groups["betas"].shape == groups["expression"].shape == (FRAMES, 10) and joints.shape == (FRAMES, 5)
    # exact meshes determine everything
    assert all((values < 1e-2).all() for values in (*groups.values(), joints))
    assert read_amass_deviations(folder / "meshes.npz") is None
    assert "--deviations is for body models" in fails(
        capsys, "fit", "human", folder / "meshes.npz", "-o", tmp_path / "other.npz", "--deviations"
    )
