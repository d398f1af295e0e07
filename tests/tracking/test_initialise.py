"""The pose of a body in a cloud, from nothing; and the starts of the search."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxcap.body.body import pose_body
from jaxcap.body.people.human import human
from jaxcap.body.pose import Pose, rest_pose
from jaxcap.body.retraction import difference, retract
from jaxcap.body.skeleton import dof_layout
from jaxcap.energy.priors.reference_pose import tangent_deviations
from jaxcap.geometry import rotation
from jaxcap.geometry.mesh import sample_surface
from jaxcap.observe.clouds import make_cloud
from jaxcap.tracking.search.initialise import initialise, scale_pose
from jaxcap.tracking.search.starts import perturbed_starts, rotated_starts, subtree_starts
from jaxcap.tracking.track_frame import make_tracker

BODY = human(resolution="low", joints="tracking")
SKELETON, LAYOUT = BODY.skeleton, dof_layout(BODY.skeleton)
UP = (0.0, 1.0, 0.0)
_pose_body = eqx.filter_jit(pose_body)


@pytest.fixture(scope="module")
def tracker():
    return make_tracker(BODY)


def scan(pose: Pose, rng, wild: int = 0):
    """600 noisy points of the surface, some of them anywhere instead."""
    vertices = np.asarray(_pose_body(BODY, pose).vertices)
    points, normals = sample_surface(vertices, np.asarray(BODY.faces), 600, rng)
    points += 0.003 * rng.normal(size=points.shape)
    points[:wild] = rng.uniform(vertices.min(0) - 1, vertices.max(0) + 1, (wild, 3))
    return make_cloud(points, normals)


def turned(pose: Pose, degrees: float, place) -> Pose:
    """Turn about the vertical, and put the root somewhere."""
    q = rotation.about_axis(jnp.asarray(UP), jnp.asarray(np.radians(degrees)))
    return Pose(
        pose.translations.at[0].set(jnp.asarray(place)),
        pose.rotations.at[0].set(rotation.multiply(q, pose.rotations[0])),
        pose.scale,
    )


def someone(rng) -> Pose:
    """Arms and legs a little out of rest, looking 120 degrees to the side, metres away."""
    change = np.zeros(SKELETON.num_dofs)
    for name in ("LeftArm", "RightArm", "LeftForeArm", "RightUpLeg", "LeftUpLeg", "RightLeg"):
        change[LAYOUT.rotations[SKELETON.index(name)]] = 0.25 * rng.normal(size=3)
    return turned(retract(SKELETON, rest_pose(SKELETON), jnp.asarray(change)), 120.0, [1.0, 0.2, -3.0])


@pytest.mark.slow
def test_a_person_is_found_from_nothing(tracker, rng):
    truth = someone(rng)
    pose, score = initialise(tracker, scan(truth, rng), turns=6, keep=2, neighbours=3, rounds=1)
    joints = [np.asarray(_pose_body(BODY, p).joints) for p in (pose, truth)]
    errors = np.linalg.norm(joints[0] - joints[1], axis=1)
    assert errors.mean() < 0.03, errors
    assert np.isfinite(float(score))


@pytest.mark.slow
def test_the_size_of_a_person_is_found_with_the_pose(tracker, rng):
    """A body of the wrong size bends its neck and knees instead."""
    truth = scale_pose(someone(rng), 0.8)
    pose, _ = initialise(
        tracker, scan(truth, rng), turns=6, keep=2, neighbours=3, rounds=1, sizes=(1.0, 0.8, 1.2)
    )
    assert float(pose.scale) == pytest.approx(0.8)
    joints = [np.asarray(_pose_body(BODY, p).joints) for p in (pose, truth)]
    assert np.linalg.norm(joints[0] - joints[1], axis=1).mean() < 0.03


def test_starts_look_in_all_directions_from_the_middle_of_the_cloud(tracker, rng):
    """In spite of one point in ten that lies anywhere: a turn that fits is among the starts."""
    truth = turned(rest_pose(SKELETON), 120.0, [1.0, 0.2, -3.0])
    starts = rotated_starts(tracker, scan(truth, rng, wild=60), rest_pose(SKELETON), 6, jnp.asarray(UP))
    errors = []
    for number in range(6):
        start = jax.tree.map(lambda leaf, number=number: leaf[number], starts)
        apart = _pose_body(BODY, start).vertices - _pose_body(BODY, truth).vertices
        errors.append(float(jnp.linalg.norm(apart, axis=1).mean()))
    assert int(np.argmin(errors)) == 2
    assert errors[2] < 0.08
    assert sorted(errors)[1] > 0.15


def test_neighbours_are_as_far_as_asked(rng):
    """The poses themselves come first, then neighbours whose tangents have the deviations given."""
    poses = jax.tree.map(lambda *leaves: jnp.stack(leaves), rest_pose(SKELETON), someone(rng))
    deviations = tangent_deviations(SKELETON, 0.1, 0.2)
    found = perturbed_starts(SKELETON, poses, 200, deviations, jax.random.key(0))
    assert found.rotations.shape == (402, SKELETON.num_joints, 4)
    np.testing.assert_allclose(found.rotations[:2], poses.rotations, atol=1e-12)
    tiled = jax.tree.map(lambda leaf: jnp.concatenate([leaf] * 201), poses)
    steps = np.asarray(jax.vmap(lambda a, b: difference(SKELETON, a, b))(tiled, found))
    assert not np.abs(steps[:2]).max() > 1e-7
    np.testing.assert_allclose(np.sqrt(np.mean(steps[2:] ** 2, 0)), deviations, rtol=0.2)
    again = perturbed_starts(SKELETON, poses, 200, deviations, jax.random.key(0))
    np.testing.assert_array_equal(found.rotations, again.rotations)


def test_a_limb_moves_while_the_rest_stays():
    """What changes is one joint and all that hangs on it; the root and single ends are not drawn."""
    pose = jax.tree.map(lambda leaf: leaf[None], rest_pose(SKELETON))
    deviations = tangent_deviations(SKELETON, 0.1, 0.2)
    found = subtree_starts(SKELETON, pose, 60, deviations, jax.random.key(1))
    moved = np.abs(np.asarray(found.rotations) - np.asarray(pose.rotations)).max(-1) > 1e-12
    assert not moved[0].any()
    turning = np.array([kind != "fixed" for kind in SKELETON.kinds])
    subtrees = [
        tuple(np.asarray(SKELETON.descendants)[joint] & turning) for joint in range(1, SKELETON.num_joints)
    ]
    drawn = {tuple(row) for row in moved[1:]}
    assert drawn <= set(subtrees)
    assert len(drawn) > 5
    assert not np.asarray(found.translations).any()
