"""Bodies and motions come back to the last bit; a wrong file is told in a sentence."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import OtherSkin

from jaxcap.body.body import Body
from jaxcap.body.pose import Motion, Pose
from jaxcap.body.skeleton import make_skeleton
from jaxcap.body.skin import DualQuaternionSkin, LinearSkin, RigidSkin, swing_twist_from
from jaxcap.errors import InputError
from jaxcap.io.archives.npz import (
    load_body,
    load_body_limits,
    load_motion,
    load_skeleton,
    save_body,
    save_motion,
)


@pytest.fixture
def skeleton(rng):
    q = rng.normal(size=(3, 4))
    return make_skeleton(
        ["Hüfte", "b c", "d"],
        [-1, 0, 1],
        ["free", "ball", "revolute"],
        rng.normal(size=(3, 3)),
        q,
        rng.normal(size=(3, 2, 3)),
    )


@pytest.fixture
def bodies(skeleton, rng):
    weights = rng.random((5, 3))
    weights /= weights.sum(1, keepdims=True)
    vertices, faces = jnp.asarray(rng.normal(size=(5, 3))), jnp.array([[0, 1, 2], [2, 3, 4]], jnp.int32)
    linear = LinearSkin(jnp.asarray(weights))
    skins = [
        linear,
        RigidSkin(jnp.array([0, 1, 2, 1, 0], jnp.int32)),
        DualQuaternionSkin(linear.weights),
        swing_twist_from(linear, skeleton),
    ]
    return [Body(skeleton, skin, vertices, faces) for skin in skins]


def same(a, b):
    a, b = np.asarray(a), np.asarray(b)
    assert a.dtype == b.dtype
    np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize("which", [0, 1, 2, 3])
def test_a_body_comes_back_to_the_last_bit(bodies, tmp_path, which):
    body, path = bodies[which], tmp_path / "body.npz"
    save_body(path, body, limits={"lower": np.array([-1.0, 2.0])})
    back = load_body(path)
    assert type(back.skin) is type(body.skin)
    for name in ("names", "parents", "kinds"):
        assert getattr(back.skeleton, name) == getattr(body.skeleton, name)
    for name in ("centres", "orientations", "axes"):
        same(getattr(back.skeleton, name), getattr(body.skeleton, name))
    same(back.vertices, body.vertices)
    same(back.faces, body.faces)
    for ours, theirs in zip(jax.tree.leaves(back.skin), jax.tree.leaves(body.skin), strict=True):
        same(ours, theirs)
    same(load_body_limits(path)["lower"], np.array([-1.0, 2.0]))
    assert [file.name for file in tmp_path.iterdir()] == ["body.npz"]


def test_a_motion_comes_back_to_the_last_bit(skeleton, tmp_path, rng):
    poses = Pose(
        jnp.asarray(rng.normal(size=(4, 3, 3))), jnp.asarray(rng.normal(size=(4, 3, 4))), jnp.ones(4) * 1.1
    )
    save_motion(tmp_path / "m.npz", Motion(poses, 29.97), skeleton)
    back = load_motion(tmp_path / "m.npz", skeleton)
    assert back.rate == 29.97
    same(back.poses.translations, poses.translations)
    same(back.poses.rotations, poses.rotations)
    same(back.poses.scale, poses.scale)
    assert load_skeleton(tmp_path / "m.npz").names == skeleton.names
    other = make_skeleton(["x", "y", "z"], [-1, 0, 1], ["free", "ball", "ball"], np.eye(3))
    with pytest.raises(InputError, match="retarget"):
        load_motion(tmp_path / "m.npz", other)


def rewrite(path, drop=(), **changes):
    with np.load(path) as file:
        arrays = {name: file[name] for name in file.files if name not in drop}
    np.savez(path, **{**arrays, **changes})


@pytest.mark.parametrize(
    ("damage", "said"),
    [
        (lambda p: p.write_text("hello"), "not an .npz file"),
        (lambda p: p.write_bytes(p.read_bytes()[:300]), "this .npz file is incomplete"),
        (lambda p: p.write_bytes(b""), "not an .npz file"),
        (lambda p: rewrite(p, vertices=np.array([{}], dtype=object)), "pickled"),
        (lambda p: np.savez(p, a=np.ones(3)), "unknown arrays"),
        (
            lambda p: (np.save(p.with_suffix(".npy"), np.ones(3)), p.with_suffix(".npy").replace(p)),
            "single array",
        ),
        (lambda p: rewrite(p, version=np.array(9)), "version 9"),
        (lambda p: rewrite(p, drop=["faces"]), "'faces' is missing"),
        (lambda p: rewrite(p, centres=np.ones((2, 3))), r"'centres' has the shape \(2, 3\)"),
        (lambda p: rewrite(p, parents=np.array([1, 2, 0])), "cycle"),
        (lambda p: rewrite(p, faces=np.array([[0, 1, 7]])), "vertex 7"),
        (lambda p: rewrite(p, skin=np.array("rubber")), "'rubber' is unknown"),
        (lambda p: rewrite(p, **{"skin.weights": np.ones((5, 4))}), "has 4 bones and the skeleton 3"),
        (
            lambda p: rewrite(p, vertices=np.array([[np.nan] * 3] * 5)),
            "'vertices' has numbers that are not finite, first in vertex 0",
        ),
        (
            lambda p: rewrite(p, **{"skin.weights": np.tile([1.5, -0.5, 0.0], (5, 1))}),
            "weight of bone 1 .* -0.5; expected weights",
        ),
        (lambda p: rewrite(p, **{"skin.weights": np.zeros((5, 3))}), "weights of vertex 0 sum to 0;"),
        (lambda p: (p.unlink(), p.mkdir()), "this is a folder; expected a body"),
        (lambda p: p.unlink(), "no such file"),
    ],
)
def test_a_wrong_file_is_told(bodies, tmp_path, damage, said):
    path = tmp_path / "body.npz"
    save_body(path, bodies[0])
    damage(path)
    with pytest.raises(InputError, match=said):
        load_body(path)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        (
            {"translations": np.array([np.zeros((2, 3)), np.full((2, 3), np.inf)])},
            "'translations' .* frame 1",
        ),
        ({"rotations": np.zeros((2, 2, 4))}, "zero quaternions"),
        ({"rotations": np.full((2, 2, 4), "1")}, "'rotations' has the type <U1; expected numbers"),
        ({"rate": np.array(0.0)}, r"the rate is 0\.0"),
    ],
)
def test_a_wrong_motion_is_told(tmp_path, changes, said):
    path = tmp_path / "m.npz"
    still = Pose(jnp.zeros((2, 2, 3)), jnp.tile(jnp.array([1.0, 0, 0, 0]), (2, 2, 1)), jnp.ones(2))
    save_motion(path, Motion(still))
    assert len(load_motion(path)) == 2
    rewrite(path, **changes)
    with pytest.raises(InputError, match=said):
        load_motion(path)


def test_a_motion_of_a_skeleton_that_stands_otherwise_is_refused(tmp_path):
    """The same names, with arms down: rotations mean other poses there."""
    still = Motion(Pose(jnp.zeros((2, 2, 3)), jnp.tile(jnp.array([1.0, 0, 0, 0]), (2, 2, 1)), jnp.ones(2)))
    out, down = (
        make_skeleton(["shoulder", "hand"], [-1, 0], ["free", "ball"], [[0.0, 0, 0], hand])
        for hand in ([0.5, 0, 0], [0, -0.5, 0])
    )
    save_motion(tmp_path / "m.npz", still, out)
    assert len(load_motion(tmp_path / "m.npz", out)) == 2
    with pytest.raises(InputError, match=r"from 'shoulder' to 'hand' differs by 90 degrees .* edit retarget"):
        load_motion(tmp_path / "m.npz", down)


def test_who_reads_a_tracked_motion_is_told_of_its_lost_frames(tmp_path):
    still = Motion(Pose(jnp.zeros((3, 2, 3)), jnp.tile(jnp.array([1.0, 0, 0, 0]), (3, 2, 1)), jnp.ones(3)))
    save_motion(tmp_path / "m.npz", still, None, ["good", "lost", "doubtful"])
    with pytest.warns(
        UserWarning, match=r"m.npz: .* 1 of 3 frames are lost \(1, .* 1 of 3 frames are doubtful \(2,"
    ):
        assert len(load_motion(tmp_path / "m.npz")) == 3
    save_motion(tmp_path / "m.npz", still, None, ["good"] * 3)
    load_motion(tmp_path / "m.npz")


def test_what_cannot_be_written_leaves_nothing(bodies, tmp_path):
    with pytest.raises(InputError, match="cannot be written"):
        save_body(tmp_path / "none" / "body.npz", bodies[0])

    body = bodies[0]
    with pytest.raises(InputError, match="OtherSkin"):
        save_body(tmp_path / "a.npz", Body(body.skeleton, OtherSkin(), body.vertices, body.faces))
    with pytest.raises(InputError, match="'limits.a' is not an array"):
        save_body(tmp_path / "a.npz", body, {"limits": np.zeros(1), "a": np.array([{}], dtype=object)})
    assert not list(tmp_path.iterdir())
