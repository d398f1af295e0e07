"""Each improvement of learning against gradients, dense solutions and known bodies."""

import itertools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxcap as jc
from jaxcap.body.body import posed_vertices
from jaxcap.body.symmetry import bone_pairs, length_differences, symmetrise
from jaxcap.geometry import rotation
from jaxcap.geometry.laplacian import make_conformance
from jaxcap.learn.objective import objective
from jaxcap.learn.skeleton.given_centres import GivenCentres
from jaxcap.learn.skeleton.joint_centre_prior import boundary_centre_prior, motion_information
from jaxcap.learn.skeleton.joints import (
    improve_joints,
    make_curvature,
    move_joints,
    normal_equations,
    shared_slots,
)
from jaxcap.learn.weights.rest_vertices import solve_rest_vertices
from tests.helpers import chain_body, random_pose

NONE = np.zeros((0, 2), int)


def scene(rng, swing_twist: bool, frames: int = 4):
    """A chain under a smooth skin, poses, and meshes of it with errors."""
    body = chain_body()
    skin = body.skin if not swing_twist else jc.body.swing_twist_from(body.skin, body.skeleton)
    body = eqx.tree_at(lambda b: b.skin, body, skin)
    turns = rng.normal(size=(body.skeleton.num_joints, 4)) * 0.2 + [1.0, 0, 0, 0]
    orientations = jnp.asarray(turns / np.linalg.norm(turns, axis=1, keepdims=True))
    body = eqx.tree_at(lambda b: b.skeleton.orientations, body, orientations)
    poses = jc.stack_poses([random_pose(body.skeleton, rng, 0.3) for _ in range(frames)]).poses
    targets = posed_vertices(body, poses) + 0.01 * rng.normal(size=(frames, len(body.vertices), 3))
    return body, poses, targets, make_conformance(np.asarray(body.faces), len(body.vertices), 10.0)


@pytest.mark.parametrize("swing_twist", [False, True])
def test_normal_equations_are_the_gradient(rng, swing_twist):
    body, poses, targets, metric = scene(rng, swing_twist)
    slots = shared_slots(body)
    arrow, (frame_side, shared_side) = normal_equations(
        body, poses, targets, metric, make_curvature(metric), slots
    )
    count = body.skeleton.num_joints

    zeros = jnp.zeros((len(targets), body.skeleton.num_dofs)), jnp.zeros(len(slots))

    def value_of(targets, shared, by_frame):
        moved = jnp.zeros(6 * count).at[np.array(slots)].set(shared).reshape(-1, 6)
        there = eqx.tree_at(
            lambda b: b.skeleton, body, move_joints(body.skeleton, moved[:, :3], moved[:, 3:])
        )
        new = jax.vmap(jc.retract, (None, 0, 0))(body.skeleton, poses, by_frame)
        return objective(there, new, targets, metric)

    by_frame, shared = jax.grad(lambda d, s: value_of(targets, s, d), (0, 1))(*zeros)
    np.testing.assert_allclose(frame_side, -by_frame / 2, rtol=1e-8, atol=1e-10)
    np.testing.assert_allclose(shared_side, -shared / 2, rtol=1e-8, atol=1e-10)
    # where nothing is left of the residual, Gauss-Newton's matrix is half the Hessian
    targets = posed_vertices(body, poses)
    hessian = jax.hessian(lambda s: value_of(targets, s, zeros[0]))(zeros[1]) / 2
    np.testing.assert_allclose(arrow.shared, hessian, atol=1e-9 * float(jnp.abs(hessian).max()))


@pytest.mark.parametrize("swing_twist", [False, True])
def test_joints_and_poses_are_found_again(rng, swing_twist):
    body, poses, _, metric = scene(rng, swing_twist, frames=8)
    targets = posed_vertices(body, poses)
    count = body.skeleton.num_joints
    shifts = 0.01 * rng.normal(size=(count, 3))
    shifts[0] = 0.0
    off = eqx.tree_at(
        lambda b: b.skeleton, body, move_joints(body.skeleton, jnp.asarray(shifts), jnp.zeros((count, 3)))
    )
    value, damping = float(objective(off, poses, targets, metric)), 1e-4
    values, curvature = [value], make_curvature(metric)
    for _ in range(6):
        off, poses, value, damping = improve_joints(
            off, poses, targets, metric, curvature, NONE, damping, value
        )
        values.append(value)
    assert all(b <= a for a, b in itertools.pairwise(values))
    assert value < 1e-6 * values[0]


def test_paired_bones_stay_equally_long(rng):
    names = ["root", "spine", "l", "ll", "r", "rr"]
    centres = rng.normal(size=(6, 3))
    skeleton = jc.make_skeleton(names, [-1, 0, 1, 2, 1, 4], ["free"] + ["ball"] * 5, centres)
    pairs = np.array([[2, 4], [3, 5]])
    even = symmetrise(skeleton, pairs)
    lengths = np.linalg.norm(
        np.diff(np.asarray(even.centres)[[[1, 2], [1, 4], [2, 3], [4, 5]]], axis=1), axis=-1
    )
    np.testing.assert_allclose(lengths[0], lengths[1], rtol=1e-10)
    np.testing.assert_allclose(lengths[2], lengths[3], rtol=1e-10)
    # eqs. 3.23 to 3.26: the right bone turned into the left one's direction by Rodrigues' formula
    differences, slopes = length_differences(skeleton, pairs)
    for row, (left, right) in enumerate(pairs):
        bones = [centres[j] - centres[skeleton.parents[j]] for j in (left, right)]
        across = np.cross(bones[1], bones[0])
        sine = np.linalg.norm(across) / np.prod([np.linalg.norm(b) for b in bones])
        cosine = bones[0] @ bones[1] / np.prod([np.linalg.norm(b) for b in bones])
        k = np.cross(np.eye(3), across / np.linalg.norm(across))
        turn = np.eye(3) + sine * k.T.T.T + (1 - cosine) * k @ k
        turn = (
            turn
            if np.allclose(turn @ bones[1] / np.linalg.norm(bones[1]), bones[0] / np.linalg.norm(bones[0]))
            else turn.T
        )
        left_over = bones[0] - turn @ bones[1]
        np.testing.assert_allclose(abs(differences[row]), np.linalg.norm(left_over), rtol=1e-9)
    step = 1e-6 * rng.normal(size=(6, 3))
    moved = eqx.tree_at(lambda s: s.centres, skeleton, skeleton.centres + step)
    change = length_differences(moved, pairs)[0] - differences
    np.testing.assert_allclose(change, jnp.einsum("pja,ja->p", slopes, step), atol=1e-11)
    assert len(bone_pairs(skeleton, np.array([[1, 2]]))) == 0


@pytest.mark.parametrize("swing_twist", [False, True])
def test_rest_vertices_are_least_squares(rng, swing_twist):
    body, poses, targets, metric = scene(rng, swing_twist)
    found = solve_rest_vertices(body, poses, targets, metric, tolerance=1e-10)

    def value(vertices):
        return objective(eqx.tree_at(lambda b: b.vertices, body, vertices), poses, targets, metric)

    slope = jax.grad(value)(found)
    assert float(jnp.abs(slope).max()) < 1e-7 * float(jnp.abs(jax.grad(value)(body.vertices)).max())
    # Q is quadratic in the rest vertices: the found ones are the only minimum
    assert value(found) < value(body.vertices)


def test_anchors_hold_what_no_motion_tells(rng):
    body, poses, _, metric = scene(rng, False, frames=12)
    labels = np.asarray(body.skin.dominant_bones())
    joint = int(labels.max())
    below = body.skeleton.descendants[joint]
    # a hinge about z, twelve times
    angles = jnp.linspace(-1.0, 1.0, 12)
    hinge = jnp.stack([jnp.cos(angles / 2), 0 * angles, 0 * angles, jnp.sin(angles / 2)], 1)
    poses = eqx.tree_at(lambda p: p.rotations, poses, poses.rotations.at[:, joint].set(hinge))
    anchors = boundary_centre_prior(body, poses, metric, 1e-4)
    rest, faces = np.asarray(body.vertices), np.asarray(body.faces)
    ends = {
        tuple(sorted((a, b)))
        for face in faces
        for a, b in ((face[0], face[1]), (face[1], face[2]), (face[2], face[0]))
        if below[labels[a]] != below[labels[b]]
    }
    expected = np.mean([(rest[a] + rest[b]) / 2 for a, b in ends], axis=0)
    np.testing.assert_allclose(anchors.means[joint], expected, atol=1e-12)
    assert not np.any(anchors.weights[0])
    along, across = anchors.weights[joint][2, 2], anchors.weights[joint][0, 0]
    told = motion_information(poses)[0][joint] * 12 * below[labels].sum()
    assert boundary_centre_prior(body, poses, metric, 1e-14).weights[joint, 2, 2] < 1e-5 * along
    far = eqx.tree_at(lambda b: b.skeleton.centres, body, body.skeleton.centres.at[joint, 0].add(9.0))
    assert boundary_centre_prior(far, poses, metric, 1e-4).weights[joint, 0, 0] > told[0, 0]
    assert told[2, 2] < 1e-12 < along and across < told[0, 0] / 100


def test_deform_is_pose_body(rng):
    body, poses, _, _ = scene(rng, True, frames=1)
    pose = jax.tree.map(lambda field: field[0], poses)
    np.testing.assert_allclose(posed_vertices(body, poses)[0], jc.pose_body(body, pose).vertices)


def test_joints_that_no_motion_tells_stay_where_a_skeleton_has_them(rng):
    body, poses, _, metric = scene(rng, False, frames=12)
    count = body.skeleton.num_joints
    # one ball joint turns by a degree, two others by much more
    still, turning = 7, [2, 5]
    slight = random_pose(body.skeleton, rng, 1.0).rotations[still]
    turns = jax.vmap(lambda share: rotation.exp(share * 0.02 * rotation.log(slight)))(jnp.linspace(-1, 1, 12))
    poses = eqx.tree_at(lambda p: p.rotations, poses, poses.rotations.at[:, still].set(turns))
    targets = posed_vertices(body, poses) + 0.0005 * rng.normal(size=(12, len(body.vertices), 3))
    shifts = np.zeros((count, 3))
    shifts[[still, *turning]] = 0.01
    off = eqx.tree_at(lambda b: b.skeleton.centres, body, body.skeleton.centres + shifts)
    given, curvature = off.skeleton.centres, make_curvature(metric)
    value, damping = float(objective(off, poses, targets, metric)), 1e-4
    for _ in range(10):
        off, poses, value, damping = improve_joints(
            off, poses, targets, metric, curvature, NONE, damping, value, given_centres=GivenCentres(given)
        )
    assert np.linalg.norm(off.skeleton.centres[still] - given[still]) < 0.001
    away = np.linalg.norm(np.asarray(off.skeleton.centres - body.skeleton.centres), axis=1)
    assert away[turning].max() < 0.004
    kept = improve_joints(off, poses, targets, metric, curvature, NONE, damping, value, given_centres=GivenCentres(off.skeleton.centres, is_fixed=True))  # fmt: skip
    assert kept.value < value
    np.testing.assert_allclose(kept.body.skeleton.centres, off.skeleton.centres, atol=1e-6)
