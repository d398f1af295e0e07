"""Expectation maximisation: the likelihood rises, and the M-step is the sum it stands for."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import chain_body, random_pose

from jaxcap.body.body import pose_body
from jaxcap.body.pose import rest_pose
from jaxcap.body.retraction import difference, retract
from jaxcap.energy.priors.reference_pose import PosePrior
from jaxcap.fit.correspondence.part_blocks import make_part_blocks
from jaxcap.observe.clouds import Cloud
from jaxcap.tracking.expectation_maximisation.em_step import (
    Estimate,
    box_volume,
    data_energy,
    e_step,
    em_step,
    first_step,
    frame_statistics,
    make_mixture_settings,
    step_statistics,
    uniform_priors,
)
from jaxcap.tracking.expectation_maximisation.subsets import Subsets, divide_cloud, first_subset, whole_cloud

BODY = chain_body("rigid")
SKELETON = BODY.skeleton
PARTS = make_part_blocks(BODY.skin.dominant_bones(), SKELETON.num_joints, BODY.vertices)
#: the paper's: distances to points, all parts, no floor under sigma; normals are not known here
MIXTURE = make_mixture_settings(
    outlier=0.1,
    smallest_sigma=1e-6,
    tangential_weight=1.0,
    damping=1e-3,
    candidates=SKELETON.num_joints,
    estimate_priors=True,
)
NO_PRIOR = PosePrior(rest_pose(SKELETON), jnp.full(SKELETON.num_dofs, jnp.inf))
NOISE = 0.005


def scene(rng, count: int = 400, wild: int = 40):
    """A pose and a cloud around it: noisy vertices, and points anywhere."""
    truth = random_pose(SKELETON, rng, 0.3)
    vertices = np.asarray(pose_body(BODY, truth).vertices)
    points = vertices[rng.integers(0, len(vertices), count)] + NOISE * rng.normal(size=(count, 3))
    points[:wild] = rng.uniform(vertices.min(0) - 0.2, vertices.max(0) + 0.2, (wild, 3))
    return truth, Cloud(jnp.asarray(points), jnp.zeros((count, 3)), jnp.ones(count))


@eqx.filter_jit
def run(mixture, cloud, start, sigma):
    """Sixty steps: the last estimate, and the statistics at each."""

    subsets, volume = whole_cloud(cloud), box_volume(cloud)

    def step(last, _):
        last = em_step(PARTS, mixture, NO_PRIOR, subsets, volume, last)
        return last, step_statistics(PARTS, mixture, subsets, volume, last)

    estimate = Estimate(start, sigma, uniform_priors(PARTS))
    last, statistics = jax.lax.scan(
        step, first_step(BODY, PARTS, mixture, subsets.clouds, estimate), length=60
    )
    return last.after, statistics


@eqx.filter_jit
def one_step(clouds, first, count, start):
    """Take a step with some of the subsets; return also its statistics."""
    subsets, volume = first_subset(Subsets(clouds, count), first), jnp.asarray(3.0)
    last = em_step(PARTS, MIXTURE, NO_PRIOR, subsets, volume, first_step(BODY, PARTS, MIXTURE, clouds, start))
    return last, step_statistics(PARTS, MIXTURE, subsets, volume, last)


def test_the_likelihood_never_falls(rng):
    """Every step of conditional maximisation raises the mixture's likelihood (Kineben, 3.3.2);
    from the truth it ends at what the scene was made of."""
    for size, damping in ((0.2, 10.0), (0.1, 1e-3), (0.05, 1e-3)):
        truth, cloud = scene(rng)
        mixture = eqx.tree_at(lambda m: m.damping, MIXTURE, jnp.asarray(damping))
        start = retract(SKELETON, truth, jnp.asarray(size * rng.normal(size=SKELETON.num_dofs)))
        last, statistics = run(mixture, cloud, start, jnp.asarray(0.1))
        rises = np.diff(statistics.log_likelihood)
        assert rises[0] > 0.1
        assert rises.min() > -1e-9
    last, statistics = run(MIXTURE, cloud, truth, jnp.asarray(0.02))
    assert float(statistics.outlier_share[-1]) == pytest.approx(0.1, abs=0.02)
    assert float(last.sigma) == pytest.approx(NOISE, rel=0.1)
    joints = [pose_body(BODY, pose).joints for pose in (last.pose, truth)]
    assert np.linalg.norm(joints[0] - joints[1], axis=1).max() < 0.005
    shares = np.bincount(BODY.skin.dominant_bones(), minlength=SKELETON.num_joints) / len(BODY.vertices)
    np.testing.assert_allclose(last.priors, shares, atol=0.05)


def test_subsets_of_a_cloud(rng):
    """A step with all subsets is that with the cloud; one with some of them is that with these alone, as heavy as all."""
    truth, cloud = scene(rng, 402)
    cloud = eqx.tree_at(lambda c: c.weights, cloud, jnp.asarray(rng.uniform(0.5, 2, 402)))
    start = Estimate(
        retract(SKELETON, truth, jnp.full(SKELETON.num_dofs, 0.02)), jnp.asarray(0.02), uniform_priors(PARTS)
    )
    clouds = divide_cloud(cloud, 100)
    assert clouds.points.shape == (4, 101, 3)
    half = eqx.tree_at(lambda c: c.weights, cloud, cloud.weights.at[::2].set(0.0))
    assert ((divide_cloud(half, 100).weights > 0).sum(1) >= 50).all()
    assert divide_cloud(cloud, 202).points.shape == (1, 402, 3)
    np.testing.assert_allclose(jnp.sum(clouds.weights), jnp.sum(cloud.weights))
    whole = whole_cloud(cloud)
    expected = one_step(whole.clouds, 0, 1, start)
    for found, true in zip(
        jax.tree.leaves(one_step(clouds, 2, 4, start)[1]), jax.tree.leaves(expected[1]), strict=True
    ):
        np.testing.assert_allclose(found, true, rtol=1e-9)
    some = one_step(clouds, 3, 2, start)[0]
    alone = Cloud(
        *(jnp.concatenate([leaf[3], leaf[0]]) for leaf in (clouds.points, clouds.normals)), jnp.zeros(202)
    )
    weights = jnp.concatenate([clouds.weights[3], clouds.weights[0]])
    weights = weights * jnp.sum(cloud.weights) / jnp.sum(weights)
    alone = whole_cloud(eqx.tree_at(lambda c: c.weights, alone, weights)).clouds
    same = one_step(alone, 0, 1, start)[0]
    for pair in ((one_step(clouds, 0, 4, start)[0], expected[0]), (some, same)):
        found, true = (step.after for step in pair)
        np.testing.assert_allclose(found.sigma, true.sigma, rtol=1e-9)
        np.testing.assert_allclose(found.priors, true.priors, atol=1e-9)
        assert float(jnp.abs(difference(SKELETON, found.pose, true.pose)).max()) < 1e-9


@pytest.mark.parametrize("tangential", [0.0, 0.3, 1.0])
def test_what_is_minimised_is_the_expected_distance(rng, tangential):
    """`sum p ((1 - t) (n . d)^2 + t |d|^2) / sigma^2`, at any scale of the body."""
    _, cloud = scene(rng, 120)
    cloud = eqx.tree_at(lambda c: c.weights, cloud, jnp.asarray(rng.uniform(0, 2, 120)).at[7].set(0.0))
    pose = random_pose(SKELETON, rng, 0.2, scale=1.2)
    estimate = Estimate(pose, jnp.asarray(0.05), uniform_priors(PARTS))
    posed, found = eqx.filter_jit(e_step)(BODY, PARTS, MIXTURE, cloud, box_volume(cloud), estimate)
    energy = data_energy(found, posed, cloud, estimate.sigma, jnp.asarray(tangential))

    def full_sum(there, normals):
        apart = there[found.vertices] - np.asarray(cloud.points)[:, None]
        across = np.sum(apart * normals[found.vertices], -1) ** 2
        distance = (1 - tangential) * across + tangential * np.sum(apart**2, -1)
        return np.sum(np.asarray(cloud.weights)[:, None] * np.asarray(found.weights) * distance) / 0.05**2

    value = float(jnp.sum(energy.residual(posed) ** 2))
    normals = np.asarray(posed.normals)
    assert value == pytest.approx(full_sum(np.asarray(posed.vertices), normals), rel=1e-9)
    # the skin is rigid, so it holds wherever the pose goes from here
    there = pose_body(BODY, random_pose(SKELETON, rng, 0.4, scale=1.2))
    value = float(jnp.sum(energy.residual(there) ** 2))
    assert value == pytest.approx(full_sum(np.asarray(there.vertices), normals), rel=1e-9)


def test_statistics_of_an_estimate(rng):
    truth, cloud = scene(rng)
    estimate = Estimate(truth, jnp.asarray(NOISE), uniform_priors(PARTS))
    found = eqx.filter_jit(frame_statistics)(BODY, PARTS, MIXTURE, cloud, box_volume(cloud), estimate)
    # the mean of |noise| in space is sigma sqrt(8 / pi)
    assert float(found.mean_distance) == pytest.approx(NOISE * np.sqrt(8 / np.pi), rel=0.1)
    assert float(found.outlier_share) == pytest.approx(0.1, abs=0.02)
    assert float(found.sigma) == NOISE


def test_the_box_is_around_what_weighs(rng):
    points = jnp.asarray([[0.0, 0, 0], [1, 2, 3], [0.5, 1, 1], [9, 9, 9]])
    cloud = Cloud(points, jnp.zeros((4, 3)), jnp.asarray([1.0, 1, 1, 0]))
    assert float(box_volume(cloud)) == 6.0
    flat = Cloud(points.at[:, 1].set(0.0), jnp.zeros((4, 3)), jnp.ones(4))
    assert float(box_volume(flat)) > 0


def test_parts_without_vertices_have_no_share():
    priors = uniform_priors(PARTS)
    present = np.isin(np.arange(SKELETON.num_joints), BODY.skin.dominant_bones())
    np.testing.assert_allclose(priors, present / present.sum(), atol=1e-15)
