"""One door for every format: the suffix says which reader it is."""

import jax.numpy as jnp
import numpy as np
import pytest
import trimesh

from jaxcap.body.pose import Motion, Pose
from jaxcap.body.skeleton import make_skeleton
from jaxcap.errors import InputError
from jaxcap.io.meshes.mesh import Mesh, write_mesh
from jaxcap.io.registry import read_body, read_motion, read_skeleton, write_motion, write_skeleton
from jaxcap.io.skeletons.vj import write_vj


@pytest.fixture
def skeleton():
    return make_skeleton(["a", "b"], [-1, 0], ["free", "ball"], [[0, 0, 0], [0, 0.5, 0]])


@pytest.fixture
def motion(rng):
    q = rng.normal(size=(3, 2, 4))
    q /= np.linalg.norm(q, axis=-1, keepdims=True)
    t = np.zeros((3, 2, 3))
    t[:, 0] = rng.normal(size=(3, 3))
    return Motion(Pose(jnp.asarray(t), jnp.asarray(q), jnp.ones(3)), 50.0)


@pytest.mark.parametrize(("suffix", "unit"), [(".bvh", None), (".bvh", "mm"), (".npz", None)])
def test_motions(skeleton, motion, tmp_path, suffix, unit):
    write_motion(tmp_path / f"a{suffix}", skeleton, motion, unit)
    tree, back = read_motion(tmp_path / f"a{suffix}", unit)
    assert tree.names == skeleton.names
    assert back.rate == 50.0
    np.testing.assert_allclose(back.poses.translations, motion.poses.translations, atol=1e-7)
    np.testing.assert_allclose(
        np.abs(np.sum(back.poses.rotations * motion.poses.rotations, -1)), 1.0, atol=1e-12
    )
    np.testing.assert_allclose(
        read_skeleton(tmp_path / f"a{suffix}", unit).centres, skeleton.centres, atol=1e-9
    )


def test_a_body_of_kinebens_files(skeleton, tmp_path):
    ball = trimesh.creation.icosphere(1, 0.9)
    write_mesh(tmp_path / "a.off", Mesh(ball.vertices, ball.faces), "cm")
    write_skeleton(tmp_path / "a.skl", skeleton, "cm")
    bones = (ball.vertices[:, 1] > 0).astype(int)
    write_vj(tmp_path / "a.vj", skeleton, bones)
    body = read_body(tmp_path / "a.off", tmp_path / "a.skl", tmp_path / "a.vj", "cm")
    np.testing.assert_allclose(body.vertices, ball.vertices, atol=1e-8)
    np.testing.assert_array_equal(body.skin.dominant_bones(), bones)
    with pytest.raises(InputError, match="looks like centimetres: pass unit='cm'"):
        read_body(tmp_path / "a.off", tmp_path / "a.skl", tmp_path / "a.vj")
    # files of its name beside it need not be given
    np.testing.assert_array_equal(read_body(tmp_path / "a.off", unit="cm").skin.dominant_bones(), bones)
    (tmp_path / "a.vj").unlink()
    with pytest.raises(InputError, match="expected a skeleton"):
        read_body(tmp_path / "a.off")


def _touched(path):
    path.touch()
    return path


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (
            lambda p, s, m: read_motion(_touched(p / "a.fbx")),
            r"an FBX file, which is not read; export \.glb from Blender \(File > Import > FBX, then File > Export",
        ),
        (lambda p, s, m: write_motion(p / "a.amc", s, m), r"not written as '\.amc'"),
        (
            lambda p, s, m: read_skeleton(_touched(p / "a")),
            r"the name has no suffix; expected a skeleton: \.skl, \.bvh",
        ),
        (lambda p, s, m: read_motion(p / "01_01.amc"), r"copy its \.asf file into the same folder"),
        (
            lambda p, s, m: read_body(_touched(p / "a.txt")),
            r"a text file; expected a body: \.npz, \.glb",
        ),
        (lambda p, s, m: read_body(p / "b.txt"), "no such file"),
        (lambda p, s, m: read_motion(p / "a.bvh"), "no such file"),
        (lambda p, s, m: read_motion(p), "this is a folder; expected a motion; give a file \\("),
        (lambda p, s, m: write_motion(p / "none" / "a.npz", s, m), "cannot be written"),
    ],
)
def test_what_has_no_reader_is_told(skeleton, motion, tmp_path, call, said):
    with pytest.raises(InputError, match=said):
        call(tmp_path, skeleton, motion)
    assert not any(path.stat().st_size for path in tmp_path.iterdir())


@pytest.mark.shared
def test_acclaim_finds_its_skeleton(shared):
    skeleton, motion = read_motion(shared / "data" / "motion" / "02_01.amc")
    assert skeleton.names[0] == "root"
    assert motion.num_frames > 300
