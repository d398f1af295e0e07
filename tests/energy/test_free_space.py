"""What a camera saw empty: where a body may not be, and where nothing is known."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import chain_body, check_energy, random_pose

import jaxcap as jc
from jaxcap.body.pose import local_rotation_vectors
from jaxcap.depth import make_depth_view
from jaxcap.energy.data.free_space import FRONT_TOLERANCE, SIDE_TOLERANCE, FreeSpace
from jaxcap.energy.priors.gaussian_pose_prior import GaussianPrior
from jaxcap.energy.priors.human_prior import human_prior
from jaxcap.energy.priors.self_collision import ALLOWED_DEPTH, make_self_collision
from jaxcap.geometry.camera import look_at
from jaxcap.scanner.ray_casting import make_ray_mesh, render_depth

BODY = chain_body()
CAMERA = look_at([0.3, 0.2, 2.5], [0.3, 0.2, 0.0], 288, 240, 60)
WALL = 3.5


def view_of(vertices, faces, camera=CAMERA, wall: float = WALL):
    depth = render_depth(camera, make_ray_mesh(np.asarray(vertices, float), np.asarray(faces))).depth
    return make_depth_view(camera, np.where(depth > 0, depth, wall), depth > 0)


def free_space(body: jc.Body, view) -> FreeSpace:
    rows = jnp.arange(len(body.vertices))
    return FreeSpace(rows, jnp.ones(len(rows)), view, jnp.asarray(0.02))


def moved(body: jc.Body, shift) -> jc.Pose:
    pose = jc.rest_pose(body.skeleton)
    return jc.Pose(pose.translations.at[0].add(jnp.asarray(shift)), pose.rotations, pose.scale)


def value_at(energy, pose) -> float:
    return float(jnp.sum(energy.residual(jc.pose_body(BODY, pose)) ** 2))


def test_the_truth_costs_nothing_and_displaced_bodies_cost_more_and_more():
    energy = free_space(BODY, view_of(BODY.vertices, BODY.faces))
    assert value_at(energy, moved(BODY, [0.0, 0, 0])) < 1.0
    for axis in (0, 1, 2):
        costs = [value_at(energy, moved(BODY, step * np.eye(3)[axis])) for step in (0.08, 0.16, 0.3)]
        assert 1.0 < costs[0] < costs[1] < costs[2]


@pytest.mark.parametrize("shift", [[0.0, 0.0, -0.4], [0.0, 0.0, -2.0], [8.0, 0.0, 0.0], [0.0, 0.0, 5.0]])
def test_what_is_behind_or_out_of_the_image_costs_and_pulls_nothing(shift):
    """Behind the measured surface, behind the wall, beside the image, behind the camera."""
    shown = np.asarray(BODY.vertices) if shift[2] in (-2.0,) else np.asarray(BODY.vertices) * [3.0, 3.0, 1.0]
    energy = free_space(BODY, view_of(shown, BODY.faces))
    pose = moved(BODY, shift)

    def cost(translation):
        there = jc.Pose(pose.translations.at[0].set(translation), pose.rotations, pose.scale)
        return jnp.sum(energy.residual(jc.pose_body(BODY, there)) ** 2)

    value, slope = jax.value_and_grad(cost)(pose.translations[0])
    assert float(value) == 0.0
    np.testing.assert_array_equal(slope, 0.0)


def test_pixels_without_measurement_tell_nothing():
    depth = np.zeros((CAMERA.height, CAMERA.width))
    depth[:2, :2] = 2.0
    view = make_depth_view(CAMERA, depth, depth > 0)
    assert value_at(free_space(BODY, view), moved(BODY, [0.0, 0, 1.0])) == 0.0


def test_violations_are_distances_in_metres():
    """A vertex in front of the surface by 10 cm, and one 10 cm beside it, in the middle of the image."""
    _, columns = np.mgrid[: CAMERA.height, : CAMERA.width]
    left = columns < CAMERA.width // 2
    view = make_depth_view(CAMERA, np.where(left, 2.5, WALL), left)
    one = jnp.zeros(1, int)
    energy = FreeSpace(one, jnp.ones(1), view, jnp.asarray(1.0))
    start = np.asarray(BODY.vertices[0], float)
    for place, expected in (
        ([0.0, 0.2, 0.1], 0.1 - FRONT_TOLERANCE),
        ([0.3 + 0.1, 0.2, 0.0], 0.1 - SIDE_TOLERANCE),
    ):
        residual = energy.residual(jc.pose_body(BODY, moved(BODY, np.array(place) - start)))
        # a pixel is 1 cm wide
        assert float(residual[0]) == pytest.approx(expected, abs=0.015)


@pytest.mark.parametrize(
    ("place", "expected"),
    [
        # in front of the trunk, 6 cm beside the hand, which the view enlarges by a pixel: as far as the hand
        ([0.15, 0.2, 0.4], 0.05 - SIDE_TOLERANCE),
        # 5 cm in front of the trunk: as far as the trunk
        ([0.3, 0.2, 0.05], 0.05 - FRONT_TOLERANCE),
        # behind the front of the hand, before the hand's pixels
        ([0.05, 0.2, 0.3], 0.0),
        # in front of the hand by 10 cm
        ([0.05, 0.2, 0.5], 0.1 - FRONT_TOLERANCE),
    ],
)
def test_a_vertex_beside_a_hand_is_moved_to_the_hand_not_into_the_trunk(place, expected):
    """A hand at the depth 2.1 m in the left of the image, before a trunk at 2.5 m, which fills it."""
    rows, columns = np.mgrid[: CAMERA.height, : CAMERA.width]
    x = (columns - CAMERA.width / 2) / float(CAMERA.focal[0]) * 2.1 + 0.3
    y = -(rows - CAMERA.height / 2) / float(CAMERA.focal[1]) * 2.1 + 0.2
    hand = (np.abs(x) < 0.09) & (np.abs(y - 0.2) < 0.2)
    view = make_depth_view(CAMERA, np.where(hand, 2.1, 2.5), np.ones_like(hand))
    energy = FreeSpace(jnp.zeros(1, int), jnp.ones(1), view, jnp.asarray(1.0))
    start = np.asarray(BODY.vertices[0], float)
    residual = energy.residual(jc.pose_body(BODY, moved(BODY, np.array(place) - start)))
    # a pixel is 1 cm wide
    assert float(residual[0]) == pytest.approx(expected, abs=0.012)


@pytest.mark.parametrize("shift", [[0.1, 0.1, -0.1], [0.02, 0.0, -0.3]])
def test_its_jacobian_is_that_of_differences(rng, shift):
    energy = free_space(BODY, view_of(np.asarray(BODY.vertices) + shift, BODY.faces))
    posed = jc.pose_body(BODY, random_pose(BODY.skeleton, rng, 0.3))

    def of(vertices):
        return energy.residual(eqx.tree_at(lambda p: p.vertices, posed, vertices))

    rows = np.flatnonzero(np.asarray(energy.residual(posed)) > 0)
    assert len(rows) > 5
    closed = np.asarray(energy.vertex_jacobian(posed)[1])[:, 0]
    for axis in range(3):
        step = 1e-6 * np.eye(3)[axis]
        numeric = (of(posed.vertices + step) - of(posed.vertices - step)) / 2e-6
        np.testing.assert_allclose(closed[rows, axis], numeric[rows], atol=1e-5 * np.abs(closed).max())


def test_a_normal_prior_is_the_mahalanobis_distance(rng):
    joints = tuple(range(1, BODY.skeleton.num_joints))
    size = 3 * len(joints)
    root = rng.normal(size=(size, size)) + 3 * np.eye(size)
    precision = root @ root.T
    mean = 0.3 * rng.normal(size=(len(joints), 3))
    energy = GaussianPrior(joints, jnp.asarray(mean), jnp.asarray(np.linalg.cholesky(precision)))
    pose = random_pose(BODY.skeleton, rng, 0.4)
    off = (np.asarray(local_rotation_vectors(BODY.skeleton, pose))[1:] - mean).reshape(-1)
    assert value_at(energy, pose) == pytest.approx(off @ precision @ off, rel=1e-9)
    check_energy(energy, BODY)


def test_people_have_a_prior_and_chains_have_none():
    skeleton = jc.human(resolution="low", joints="tracking").skeleton
    prior, whole = human_prior(skeleton), human_prior(jc.human(resolution="low").skeleton)
    assert prior is not None and whole is not None
    # the marginal distribution of fewer joints
    shared = [whole.joints.index(joint) for joint in prior.joints]
    columns = (3 * np.array(shared)[:, None] + np.arange(3)).reshape(-1)
    covariances = [
        np.linalg.inv(np.asarray(p.factor, float) @ np.asarray(p.factor, float).T) for p in (prior, whole)
    ]
    np.testing.assert_allclose(covariances[0], covariances[1][np.ix_(columns, columns)], rtol=1e-3, atol=1e-4)
    np.testing.assert_allclose(prior.mean, whole.mean[jnp.asarray(shared)], atol=1e-6)
    assert human_prior(BODY.skeleton) is None


def test_an_arm_in_the_trunk_costs_its_depth():
    body = jc.human(resolution="low", joints="tracking")
    energy = make_self_collision(body)
    assert energy is not None
    rest = jc.rest_pose(body.skeleton)
    assert float(jnp.sum(energy.residual(jc.pose_body(body, rest)) ** 2)) == 0.0
    # the forearm turned through the belly
    skeleton = body.skeleton
    costs = []
    for share in (0.0, 0.5, 1.0):
        turn = jc.geometry.rotation.exp(share * jnp.array([0.0, 0.0, -1.1]))
        pose = jc.Pose(rest.translations, rest.rotations.at[skeleton.index("LeftArm")].set(turn), rest.scale)
        costs.append(float(jnp.max(energy.residual(jc.pose_body(body, pose)) * 0.01)))
    assert costs[0] == 0.0 and costs[-1] > ALLOWED_DEPTH
    assert make_self_collision(BODY) is None
