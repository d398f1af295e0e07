"""A body takes the shape and the poses of another person, also from a single mesh with strongly bent joints."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import random_pose

import jaxcap as jc
from jaxcap.adapt.shape.joint_regressor import make_joint_regressor, regress_joints
from jaxcap.body.body import posed_vertices
from jaxcap.body.pose import Pose, stack_poses
from jaxcap.body.symmetry import bone_pairs, find_left_right_pairs, length_differences
from jaxcap.geometry import rotation
from jaxcap.learn.people.initialise_person import Reference, initialise_person
from jaxcap.learn.people.joints_of_surface import joints_of_bones, joints_of_surface
from jaxcap.learn.skeleton.given_centres import GivenCentres
from tests.learn.people.made_limb import limb


def reference_of(body: jc.Body) -> Reference:
    none = np.zeros((0, 2), int)
    return Reference(body, make_joint_regressor(body), none, GivenCentres(body.skeleton.centres), 1e-3)


def bent(body: jc.Body, angle: float) -> Pose:
    """Bend the second joint about an axis across the limb; a stack of one pose."""
    turn = rotation.exp(jnp.array([0.0, 0.0, angle]))
    rotations = jnp.broadcast_to(rotation.identity(turn.dtype), (body.skeleton.num_joints, 4)).at[1].set(turn)
    return Pose(jnp.zeros((1, body.skeleton.num_joints, 3)), rotations[None], jnp.ones(1))


def rotation_errors(found: Pose, true: Pose) -> np.ndarray:
    """Measure the angles between rotations of joints, degrees."""
    cosines = np.abs(np.sum(np.asarray(found.rotations) * np.asarray(true.rotations), -1))
    return 2 * np.degrees(np.arccos(np.clip(cosines, 0, 1)))


def test_a_body_takes_the_shape_of_a_larger_person(rng):
    first, true = limb(), limb(1.25, 0.075)
    poses = stack_poses([random_pose(true.skeleton, rng, 0.25) for _ in range(4)]).poses
    targets = posed_vertices(true, poses)
    found = initialise_person(reference_of(first), targets)
    bones = np.diff(np.asarray(found.body.skeleton.centres), axis=0)
    np.testing.assert_allclose(np.linalg.norm(bones, axis=1), [1.25 * 0.33, 1.25 * 0.35], atol=0.02)
    posed = posed_vertices(found.body, found.poses)
    assert float(jnp.sqrt(jnp.mean(jnp.sum((posed - targets) ** 2, -1)))) < 0.02


@pytest.mark.parametrize("angle", [0.8, 1.6])
def test_a_single_mesh_with_a_bent_joint_gives_lengths_and_rotations(angle):
    first, true = limb(), limb(1.2, 0.06)
    poses = bent(true, angle)
    targets = posed_vertices(true, poses)
    found = initialise_person(reference_of(first), targets)
    assert rotation_errors(found.poses, poses).max() < 0.5
    lengths = np.linalg.norm(np.diff(np.asarray(found.body.skeleton.centres), axis=0), axis=1)
    np.testing.assert_allclose(lengths, [1.2 * 0.33, 1.2 * 0.35], rtol=0.03)
    np.testing.assert_allclose(posed_vertices(found.body, found.poses), targets, atol=1e-3)


def test_bones_place_a_bent_joint_better_than_the_surface_around_it():
    first, true = limb(), limb(1.2, 0.06)
    poses = bent(true, 1.6)
    mesh = np.asarray(posed_vertices(true, poses), float)
    pose = jax.tree.map(lambda leaf: leaf[0], poses)
    joints = np.asarray(jc.pose_body(true, pose).joints)
    regressor = make_joint_regressor(first)
    around = regress_joints(regressor, mesh[0])
    _, posed = joints_of_surface(first, around[None], poses, jnp.asarray(mesh))
    away = [np.linalg.norm(each - joints, axis=1)[1] for each in (around, posed[0])]
    assert away[1] < 0.5 * away[0]


@pytest.mark.parametrize("scale", [0.4, 1.3, 2.2])
def test_a_scaled_and_rotated_body_has_its_joints_exactly(scale, rng):
    body = limb()
    turn = rotation.to_matrix(rotation.normalise(jnp.asarray(rng.normal(size=4))))
    moved = scale * np.asarray(body.vertices) @ np.asarray(turn).T + 0.2
    turns = np.broadcast_to(np.asarray(turn), (1, body.skeleton.num_joints, 3, 3))
    found = joints_of_bones(body, turns, moved[None])
    expected = scale * np.asarray(body.skeleton.centres) @ np.asarray(turn).T + 0.2
    np.testing.assert_allclose(found[0], expected, atol=1e-9)


def test_bones_that_are_longer_but_not_wider_have_their_joints_at_their_ends():
    body, longer = limb(skin="rigid"), limb(1.3, skin="rigid")
    turns = np.broadcast_to(np.eye(3), (1, 3, 3, 3))
    found = joints_of_bones(body, turns, np.asarray(longer.vertices, float)[None])
    np.testing.assert_allclose(found[0], longer.skeleton.centres, atol=1e-9)


def test_bones_with_few_vertices_or_none_leave_joints_to_the_others():
    body = limb(skin="rigid")
    none = eqx.tree_at(lambda b: b.skin.bones, body, jnp.where(body.skin.bones == 2, 1, body.skin.bones))
    one = eqx.tree_at(lambda b: b.skin.bones, none, none.skin.bones.at[-1].set(2))
    turns = np.broadcast_to(np.eye(3), (1, 3, 3, 3))
    mesh = 1.2 * np.asarray(body.vertices, float)[None]
    for lacking in (none, one):
        found = joints_of_bones(lacking, turns, mesh)[0]
        np.testing.assert_allclose(found, 1.2 * np.asarray(body.skeleton.centres), atol=1e-9)


def test_paired_bones_are_equally_long_next_to_joints_on_the_middle(rng):
    body = jc.human(resolution="low")
    skeleton = body.skeleton
    pairs = np.array(find_left_right_pairs(skeleton))
    normals = np.zeros((skeleton.num_joints, 3))
    normals[np.abs(np.asarray(skeleton.centres)[:, 0]) < 1e-3, 0] = 1.0
    given = GivenCentres(skeleton.centres, normals=jnp.asarray(normals))
    # a surface that leans to one side
    vertices = np.asarray(body.vertices, float)
    leaning = vertices + 0.05 * np.sin(3 * vertices[:, 1:2]) * [1.0, 0, 0]
    reference = Reference(body, make_joint_regressor(body), pairs, given, 1e-3)
    found = initialise_person(reference, jnp.asarray(leaning)[None]).body.skeleton
    sideways = np.asarray(found.centres - skeleton.centres)[normals[:, 0] > 0, 0]
    assert np.ptp(sideways) < 1e-3
    assert np.abs(length_differences(found, bone_pairs(skeleton, pairs))[0]).max() < 1e-5
