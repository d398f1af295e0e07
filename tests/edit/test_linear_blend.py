"""Linear blending that follows other skins: held to `pose_body` of the skin that it follows, in the
poses it was made for and in others."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from command_line import runs
from helpers import chain_body, random_pose
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation

from jaxcap.body.body import Body, pose_body
from jaxcap.body.kinematics import forward_kinematics, joint_positions
from jaxcap.body.people.human import human
from jaxcap.body.people.sample import sample_poses
from jaxcap.body.people.walk_and_wave import walk_and_wave
from jaxcap.body.pose import Pose, rest_pose, stack_poses
from jaxcap.body.skin import DualQuaternionSkin, LinearSkin, swing_twist_from
from jaxcap.edit.linear_blend.convert import linear_motion, linear_pose, to_linear_blend
from jaxcap.edit.linear_blend.influences import limit_influences
from jaxcap.edit.linear_blend.weights import fit_linear_weights
from jaxcap.io.archives.npz import load_body, save_body, save_motion
from jaxcap.io.skeletons.bvh import read_bvh, write_bvh
from tests.io.skinned.test_gltf import check_against_pose_body


@eqx.filter_jit
def _surfaces(body: Body, poses: Pose) -> jax.Array:
    return jax.lax.map(lambda pose: pose_body(body, pose).vertices, poses)


def _apart(body: Body, other: Body, poses: Pose, other_poses: Pose) -> np.ndarray:
    """(F, V) metres."""
    return np.linalg.norm(_surfaces(body, poses) - _surfaces(other, other_poses), axis=-1)


def _nonlinear(skin: str) -> Body:
    """The forked tube, in which every joint turns about an axis askew."""
    body = chain_body("linear")
    tilted = Rotation.random(body.skeleton.num_joints, random_state=3).as_quat(scalar_first=True)
    body = eqx.tree_at(lambda b: b.skeleton.orientations, body, jnp.asarray(tilted))
    bound = (
        DualQuaternionSkin(body.skin.weights)
        if skin == "dual quaternion"
        else swing_twist_from(body.skin, body.skeleton)
    )
    return eqx.tree_at(lambda b: b.skin, body, bound)


def take_joints(skeleton, count: int):
    """The first joints of a skeleton."""
    fields = ("names", "parents", "kinds", "centres", "orientations", "axes")
    return type(skeleton)(*(getattr(skeleton, field)[:count] for field in fields))


def test_a_human_with_twisted_arms():
    """The waving human under swing-twist skinning: within the tolerance, several times nearer
    than LBS of the same weights, and as near in frames between those that it was made for."""
    body = human(resolution="low")
    body = eqx.tree_at(lambda b: b.skin, body, swing_twist_from(body.skin, body.skeleton))
    performance = walk_and_wave(body.skeleton, seconds=2.0, rate=20.0)
    # from a hand on the hip to one held up: forearms and upper arms twist too
    twist = np.radians(80 * np.sin(np.linspace(0, 6, 40)))
    rotations = performance.poses.rotations
    for name in ("LeftForeArm", "RightArm"):
        joint = body.skeleton.index(name)
        axis = Rotation.from_quat(body.skeleton.orientations[joint].tolist(), scalar_first=True).apply(
            [1, 0, 0]
        )
        turns = Rotation.from_quat(np.array(rotations[:, joint]), scalar_first=True)
        turns = turns * Rotation.from_rotvec(twist[:, None] * axis)
        rotations = rotations.at[:, joint].set(turns.as_quat(scalar_first=True))
    performance = eqx.tree_at(lambda m: m.poses.rotations, performance, rotations)
    given, held = performance.slice(slice(0, None, 2)), performance.slice(slice(1, None, 2))
    found = to_linear_blend(body, given.poses, tolerance=0.002)
    errors = _apart(body, found.body, given.poses, linear_motion(found, given).poses)
    assert errors.max() == pytest.approx(found.error)
    assert errors.mean() == pytest.approx(found.mean_error)
    assert found.error <= 0.002
    plain = eqx.tree_at(lambda b: b.skin, body, LinearSkin(body.skin.bone_weights(31)))
    naive = _apart(body, plain, given.poses, given.poses)
    assert naive.max() > 0.01
    assert naive.mean() > 4 * errors.mean()
    # frames that it has not seen
    assert _apart(body, found.body, held.poses, linear_motion(found, held).poses).max() < 0.0025
    weights = np.asarray(found.body.skin.weights)
    assert (weights > 0).sum(1).max() <= 4
    np.testing.assert_allclose(weights.sum(1), 1.0, atol=1e-6)
    assert weights.min() >= 0
    assert weights.any(0)[31:].all()
    assert found.body.skeleton.names[:31] == body.skeleton.names


@pytest.mark.parametrize("skin", ["dual quaternion", "swing-twist"])
def test_bones_of_every_vertex_are_exact_in_every_pose(skin, rng):
    """With a bone wherever there is an error the skins agree, also in poses that were not given:
    virtual bones are functions of the joints."""
    body = _nonlinear(skin)
    given = stack_poses([random_pose(body.skeleton, rng, 0.5) for _ in range(6)]).poses
    found = to_linear_blend(body, given, tolerance=1e-9, max_influences=8, max_virtual_bones=1000)
    assert found.error < 1e-8
    others = stack_poses([random_pose(body.skeleton, rng, 0.7, scale) for scale in (1.0, 1.3, 0.8)])
    assert _apart(body, found.body, others.poses, linear_motion(found, others).poses).max() < 1e-6
    # what does not slide has no shift, so BVH needs no channels for it
    kinds = np.array(found.body.skeleton.kinds)
    moved = np.abs(linear_motion(found, others).poses.translations).max((0, 2))
    assert moved[kinds == "ball"].max() == 0.0


def test_fewer_bones_for_a_looser_tolerance(rng, tmp_path):
    """And what was made goes through BVH and .glb."""
    body = _nonlinear("swing-twist")
    motion = stack_poses([random_pose(body.skeleton, rng, 0.4) for _ in range(12)], rate=20.0)
    counts = []
    for tolerance in (0.02, 0.001):
        found = to_linear_blend(body, motion.poses, tolerance)
        assert found.error <= tolerance
        counts.append(found.body.skeleton.num_joints)
    assert counts == sorted(counts)
    assert counts[0] < counts[-1]
    few = to_linear_blend(body, motion.poses, 1e-6, max_virtual_bones=5)
    assert few.body.skeleton.num_joints <= body.skeleton.num_joints + 5
    assert few.error > 1e-6
    longer = linear_motion(found, motion)
    write_bvh(tmp_path / "motion.bvh", found.body.skeleton, longer)
    skeleton, back = read_bvh(tmp_path / "motion.bvh")
    here = joint_positions(found.body.skeleton, forward_kinematics(found.body.skeleton, longer[7]))
    there = joint_positions(skeleton, forward_kinematics(skeleton, back[7]))
    order = [skeleton.names.index(name) for name in found.body.skeleton.names if name in skeleton.names]
    assert len(order) > body.skeleton.num_joints
    kept = [number for number, name in enumerate(found.body.skeleton.names) if name in skeleton.names]
    np.testing.assert_allclose(np.asarray(there)[order], np.asarray(here)[kept], atol=1e-6)


def test_convert_to_glb_tells_the_error(tmp_path, capsys, rng):
    body = _nonlinear("swing-twist")
    motion = stack_poses([random_pose(body.skeleton, rng, 0.4) for _ in range(12)], rate=20.0)
    save_body(tmp_path / "body.npz", body)
    save_motion(tmp_path / "motion.npz", motion, body.skeleton)
    told = runs(
        capsys, "convert", tmp_path / "body.npz", tmp_path / "body.glb",
        "--motion", tmp_path / "motion.npz", "--tolerance", "0.001",
    )  # fmt: skip
    assert told.count("\n") == 1
    assert "48 vertices, 9 joints" in told
    assert "over 12 frames" in told
    found = to_linear_blend(load_body(tmp_path / "body.npz"), motion.poses, 0.001)
    assert f"largest error {1000 * found.error:.2g} mm" in told
    # what is in the file is what the body does
    check_against_pose_body(tmp_path / "body.glb", found.body, linear_motion(found, motion), (0, 5, 11))


def test_weights_are_the_best_ones_on_the_simplex(rng):
    """Against a general optimiser, where no weights fit."""
    frames = np.concatenate(
        [Rotation.random(20, random_state=4).as_matrix().reshape(5, 4, 3, 3), rng.normal(size=(5, 4, 3, 1))],
        3,
    )
    vertices, targets = rng.normal(size=(6, 3)), 0.3 * rng.normal(size=(5, 6, 3))
    candidates = np.tile([2, 0, 3, 1], (6, 1))
    candidates[0, 3] = candidates[4, 1] = -1
    weights, errors = fit_linear_weights(vertices, targets, frames, candidates, influences=4)
    for v in range(6):
        there = candidates[v] >= 0
        carried = np.einsum("fbac,c->bfa", frames[:, candidates[v, there]], [*vertices[v], 1.0])
        gap = lambda w: np.sum((np.tensordot(w, carried, 1) - targets[:, v]) ** 2)  # noqa: B023, E731
        start = np.full(there.sum(), 1 / there.sum())
        best = minimize(
            gap, start, method="SLSQP", bounds=[(0, 1)] * there.sum(), tol=1e-12,
            constraints={"type": "eq", "fun": lambda w: w.sum() - 1},
        )  # fmt: skip
        np.testing.assert_allclose(weights[v, there], best.x, atol=1e-5)
        assert not weights[v, ~there].any()
        missed = np.linalg.norm(np.tensordot(best.x, carried, 1) - targets[:, v], axis=1)
        assert errors[v] == pytest.approx(missed.max(), abs=1e-4)
    two, _ = fit_linear_weights(vertices, targets, frames, candidates, influences=2)
    assert (two > 0).sum(1).max() == 2
    np.testing.assert_allclose(two.sum(1), 1.0)


def test_of_bones_that_move_alike_one_is_enough(rng):
    frames = np.concatenate([Rotation.random(15, random_state=2).as_matrix().reshape(5, 3, 3, 3)] * 2, 1)[
        :, :4
    ]
    frames = np.concatenate([frames, 0.2 * rng.normal(size=(5, 4, 3, 1))], 3)
    frames[:, 3] = frames[:, 2]
    vertices, known = rng.normal(size=(6, 3)), np.array([0.15, 0.25, 0.6])
    homogeneous = np.concatenate([vertices, np.ones((6, 1))], 1)
    targets = np.einsum("b,fbac,vc->fva", known, frames[:, :3], homogeneous)
    weights, errors = fit_linear_weights(
        vertices, targets, frames, np.tile(np.arange(4), (6, 1)), influences=3
    )
    assert errors.max() < 1e-6
    np.testing.assert_allclose(weights[:, :2], np.tile(known[:2], (6, 1)), atol=1e-5)


def test_what_blends_linearly_already_stays(rng):
    body = chain_body("linear")
    poses = stack_poses([random_pose(body.skeleton, rng) for _ in range(3)])
    whole = to_linear_blend(body, poses.poses, max_influences=9)
    assert whole.error < 1e-12
    np.testing.assert_array_equal(linear_motion(whole, poses).poses.rotations, poses.poses.rotations)
    np.testing.assert_array_equal(linear_pose(whole, poses[0]).rotations, poses[0].rotations)
    few = to_linear_blend(body, poses.poses, max_influences=2)
    errors = _apart(body, few.body, poses.poses, poses.poses)
    assert errors.max() > 0.001
    assert few.error == pytest.approx(errors.max())
    assert (np.asarray(few.body.skin.bone_weights(9)) > 0).sum(1).max() == 2
    # the strongest two are not the best two
    kept = _apart(body, limit_influences(body, 2), poses.poses, poses.poses)
    assert errors.max() < 0.9 * kept.max()


def test_sampled_poses_keep_to_their_kinds():
    skeleton = chain_body("linear").skeleton
    poses = sample_poses(skeleton, 20, seed=1)
    turned = np.asarray(poses.rotations)
    np.testing.assert_allclose(turned[0], np.tile([1.0, 0, 0, 0], (9, 1)), atol=1e-15)
    for joint, kind in enumerate(skeleton.kinds):
        vectors = turned[1:, joint, 1:]
        if kind == "revolute":
            np.testing.assert_allclose(np.cross(vectors, skeleton.axes[joint, 0]), 0.0, atol=1e-12)
        assert vectors.any() == (kind not in ("fixed", "translate", "free"))
    assert not np.asarray(poses.translations).any()
    angles = 2 * np.arccos(np.clip(np.abs(turned[..., 0]), 0, 1))
    # twice half a radian about each of three axes
    assert 0.3 < angles[:, 2].max() < np.sqrt(3) + 1e-9


def test_what_cannot_be_converted_is_said(rng):
    body = _nonlinear("swing-twist")
    poses = stack_poses([random_pose(body.skeleton, rng)]).poses
    other = stack_poses([rest_pose(take_joints(body.skeleton, 4))])
    for arguments, sentence in (
        ((body, random_pose(body.skeleton, rng)), "stacked"),
        ((body, other.poses), "4 joints"),
        ((body, poses, 0.0), "positive"),
    ):
        with pytest.raises(ValueError, match=sentence):
            to_linear_blend(*arguments)
    with pytest.raises(ValueError, match="at least 1"):
        sample_poses(body.skeleton, 0)
    with pytest.raises(ValueError, match="4 joints"):
        linear_motion(to_linear_blend(body, poses), other)
