"""The prior of people's poses for skeletons of other names and rest poses."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxcap as jc
from jaxcap.body.kinematics import forward_kinematics, joint_positions
from jaxcap.energy.priors.human_prior import _even_normals, human_prior
from jaxcap.geometry import rotation

HUMAN = jc.human(resolution="low", joints="tracking").skeleton
#: names as in SMPL
NAMES = {
    "Hips": "pelvis", "LeftUpLeg": "left_hip", "LeftLeg": "left_knee", "LeftFoot": "left_ankle", "LeftToeBase": "left_foot",
    "LowerBack": "spine1", "Spine": "spine2", "Spine1": "spine3", "LeftShoulder": "left_collar", "LeftArm": "left_shoulder",
    "LeftForeArm": "left_elbow", "LeftHand": "left_wrist", "Neck": "neck", "Head": "head",
}  # fmt: skip
RENAMED = {**NAMES, **{k.replace("Left", "Right"): v.replace("left", "right") for k, v in NAMES.items()}}


@pytest.fixture(scope="module")
def poses():
    """Twenty poses of people, and their energies under the prior of the embedded human."""
    prior = human_prior(HUMAN)
    factor = np.asarray(prior.factor, float)
    normals = np.random.default_rng(1).normal(size=(20, len(factor)))
    vectors = np.asarray(prior.mean) + (normals @ np.linalg.inv(factor)).reshape(20, -1, 3)
    joints = jnp.asarray(prior.joints)
    frames = jnp.tile(HUMAN.orientations[joints], (20, 1, 1))
    turns = rotation.exp(rotation.rotate(frames, jnp.asarray(vectors)))
    rotations = jnp.tile(rotation.identity(), (20, HUMAN.num_joints, 1)).at[:, joints].set(turns)
    found = jc.Pose(jnp.zeros((20, HUMAN.num_joints, 3)), rotations, jnp.ones(20))
    return found, np.sum(normals**2, 1)


def energies(skeleton, poses) -> np.ndarray:
    """The energies of poses under the prior of a skeleton."""
    prior = human_prior(skeleton)
    joints = jnp.asarray(prior.joints)
    frames = jnp.tile(rotation.conjugate(skeleton.orientations[joints]), (len(poses.scale), 1, 1))
    logs = rotation.rotate(frames, rotation.log(poses.rotations[:, joints]))
    off = np.asarray(logs - prior.mean).reshape(len(poses.scale), -1) @ np.asarray(prior.factor)
    return np.sum(off**2, 1)


def renamed(centres, orientations=None):
    """The embedded human's tree with SMPL's names."""
    names = [RENAMED.get(name, name) for name in HUMAN.names]
    return jc.make_skeleton(names, HUMAN.parents, HUMAN.kinds, centres, orientations)


def test_other_names_and_axes_change_no_energy(poses):
    skeleton = renamed(HUMAN.centres)
    assert human_prior(skeleton).joints == tuple(sorted(human_prior(HUMAN).joints))
    np.testing.assert_allclose(energies(skeleton, poses[0]), poses[1], rtol=2e-3)


def test_a_rest_pose_with_raised_arms_has_the_prior_of_the_same_people(poses):
    raised = jc.rest_pose(HUMAN).rotations
    for name, angle in (("LeftArm", 0.7), ("RightArm", -0.7)):
        turn = rotation.about_axis(jnp.array([0.0, 0.0, 1.0]), jnp.asarray(angle))
        raised = raised.at[HUMAN.index(name)].set(turn)
    rest = jc.Pose(jnp.zeros((HUMAN.num_joints, 3)), raised, jnp.ones(()))
    placed = forward_kinematics(HUMAN, rest)
    skeleton = renamed(joint_positions(HUMAN, placed))
    # the same rotations of the bones, from the new rest pose
    whole = jax.vmap(forward_kinematics, (None, 0))(HUMAN, poses[0]).rotations @ jnp.swapaxes(
        placed.rotations, -1, -2
    )
    parents = np.array(HUMAN.parents)
    above = jnp.where((parents < 0)[:, None, None], jnp.eye(3), whole[:, np.maximum(parents, 0)])
    local = rotation.from_matrix(jnp.swapaxes(above, -1, -2) @ whole)
    found = energies(skeleton, jc.Pose(poses[0].translations, local, poses[0].scale))
    # a normal distribution of other rotation vectors is not quite the same
    np.testing.assert_allclose(found, poses[1], rtol=0.25)
    assert np.corrcoef(found, poses[1])[0, 1] > 0.9
    # without the rotation of the rest pose they are other poses
    assert np.median(energies(skeleton, poses[0]) / poses[1]) > 1.3


def test_samples_have_the_covariance_exactly(rng):
    root = rng.normal(size=(5, 5))
    found = _even_normals(root @ root.T + np.eye(5))
    np.testing.assert_allclose(np.cov(found.T), root @ root.T + np.eye(5), atol=1e-9)
    np.testing.assert_allclose(found.mean(0), 0.0, atol=1e-12)


def test_joints_without_names_of_a_person_have_no_prior():
    unnamed = jc.make_skeleton(
        [f"joint{k}" for k in range(HUMAN.num_joints)], HUMAN.parents, HUMAN.kinds, HUMAN.centres
    )
    assert human_prior(unnamed) is None
