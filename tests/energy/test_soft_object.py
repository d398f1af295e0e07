"""A soft body against its closed form, finite differences, and the surface that it stands for."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cylinder import cylinder
from helpers import chain_body, check_energy, random_pose

import jaxcap
from jaxcap.body.body import pose_body
from jaxcap.body.pose import Pose, rest_pose
from jaxcap.energy.data.soft_object import ROUNDING, SoftObject, SoftPoints, make_soft_object, soft_distance
from jaxcap.energy.priors.reference_pose import RestPrior
from jaxcap.fit.solve import solve
from jaxcap.geometry import rotation

BODY = chain_body("rigid")
SKELETON = BODY.skeleton
SOFT = make_soft_object(BODY)
solve_ = eqx.filter_jit(solve)


@eqx.filter_jit
def distances(soft, body, pose, points):
    return soft_distance(soft, pose_body(body, pose), points)


@eqx.filter_jit
def residual_of(energy, body, pose):
    return energy.residual(pose_body(body, pose))


@eqx.filter_jit
@eqx.filter_grad
def sensitivity(energy, body, pose):
    return jnp.sum(energy.residual(pose_body(body, pose)) ** 2)


@eqx.filter_jit
def slopes(soft, body, pose, points):
    return jax.vmap(jax.grad(lambda x: soft_distance(soft, pose_body(body, pose), x[None])[0]))(points)


def sphere(radius: float = 0.2, bone: int = 0, centre=(0.0, 0.0, 0.0)) -> SoftObject:
    return SoftObject(
        jnp.array([bone]),
        jnp.array([centre]),
        jnp.eye(3)[None] / radius**2,
        jnp.asarray(30.0),
    )


def on_skin(soft: SoftObject, pose: Pose, points):
    """Points led to the skin along its slopes."""
    for _ in range(30):
        slope = slopes(soft, BODY, pose, points)
        away = distances(soft, BODY, pose, points)[:, None]
        points = points - away * slope / jnp.sum(slope**2, 1, keepdims=True)
    return points


def surface_points(pose: Pose, rng, count: int):
    """Points drawn from the triangles of the posed chain."""
    posed = pose_body(BODY, pose)
    corners = posed.vertices[BODY.faces[rng.integers(0, len(BODY.faces), count)]]
    return jnp.einsum("nk,nka->na", jnp.asarray(rng.dirichlet(np.ones(3), count)), corners)


def test_one_sphere_by_hand(rng):
    """A cone of distances, rounded off at its tip: zero on the sphere, of slope one there."""
    rest, radius = rest_pose(SKELETON), 0.2
    directions = rng.normal(size=(40, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    lengths = np.linspace(0.0, 1.0, 40)
    expected = radius * (np.sqrt((lengths / radius) ** 2 + ROUNDING**2) - np.sqrt(1 + ROUNDING**2))
    found = distances(sphere(), BODY, rest, jnp.asarray(lengths[:, None] * directions))
    np.testing.assert_allclose(found, expected, atol=1e-14)
    surface = jnp.asarray(radius * directions)
    np.testing.assert_allclose(distances(sphere(), BODY, rest, surface), 0.0, atol=1e-14)
    np.testing.assert_allclose(slopes(sphere(), BODY, rest, surface), directions, atol=6e-3)


def test_one_ellipsoid_is_its_own_skin_and_measured_along_its_axes(rng):
    axes = np.array([0.05, 0.1, 0.3])
    turn = np.asarray(rotation.to_matrix(rotation.exp(jnp.asarray(rng.normal(size=3)))))
    soft = SoftObject(
        jnp.array([0]),
        jnp.zeros((1, 3)),
        jnp.asarray((turn / axes**2) @ turn.T)[None],
        jnp.asarray(30.0),
    )
    unit = rng.normal(size=(50, 3))
    skin = (unit / np.linalg.norm(unit, axis=1, keepdims=True) * axes) @ turn.T
    rest = rest_pose(SKELETON)
    np.testing.assert_allclose(distances(soft, BODY, rest, jnp.asarray(skin)), 0.0, atol=1e-14)
    lengths = np.linalg.norm(slopes(soft, BODY, rest, jnp.asarray(skin)), axis=1)
    # less at the tips of a long one, by what rounds its centre
    assert (np.abs(lengths - 1) < 0.12).all()
    outside = jnp.asarray((3 * axes * np.eye(3)) @ turn.T)
    np.testing.assert_allclose(distances(soft, BODY, rest, outside), 2 * axes, rtol=0.02)


@pytest.mark.parametrize("robust", [np.inf, 0.05])
def test_points_against_central_differences(rng, robust):
    """Points on the skin, off it, at a centre, and one of no weight."""
    points = surface_points(random_pose(SKELETON, rng, 0.3), rng, 20)
    points = jnp.concatenate([points, points[:10] + 0.1 * rng.normal(size=(10, 3)), SOFT.centres[:3]])
    weights = jnp.asarray(rng.uniform(0.2, 2.0, len(points))).at[4].set(0.0)
    energy = SoftPoints(SOFT, points, weights, robust)
    check_energy(energy, BODY, [random_pose(SKELETON, rng, 0.8, scale=1.3)])


def test_a_rigid_motion_and_a_scale_of_both_change_nothing_but_the_scale(rng):
    pose = random_pose(SKELETON, rng, 0.4)
    points = surface_points(pose, rng, 30) + 0.05 * rng.normal(size=(30, 3))
    before = distances(SOFT, BODY, pose, points)
    turn, shift = rotation.exp(jnp.asarray(rng.normal(size=3))), jnp.asarray(rng.normal(size=3))
    # the root turns about its centre, which is the origin of this chain
    rooted = Pose(
        pose.translations.at[0].set(rotation.rotate(turn, pose.translations[0]) + shift),
        pose.rotations.at[0].set(rotation.multiply(turn, pose.rotations[0])),
        jnp.asarray(1.4),
    )
    moved = 1.4 * (rotation.rotate(jnp.broadcast_to(turn, (30, 4)), points) + shift)
    np.testing.assert_allclose(distances(SOFT, BODY, rooted, moved), 1.4 * before, atol=1e-12)


def test_what_has_no_weight_is_not_there(rng):
    pose = random_pose(SKELETON, rng, 0.4)
    points = surface_points(pose, rng, 12) + 0.02
    weights = jnp.ones(12).at[:3].set(0.0)
    one = SoftPoints(SOFT, points, weights, 0.05)
    for nowhere in (1e6, np.nan):
        other = SoftPoints(SOFT, points.at[:3].set(nowhere), weights, 0.05)
        np.testing.assert_array_equal(residual_of(one, BODY, pose), residual_of(other, BODY, pose))
        gradient = sensitivity(other, BODY, pose)
        assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(gradient))
        assert not np.any(gradient.points[:3])


def test_at_a_centre_all_is_smooth():
    posed = rest_pose(SKELETON)
    energy = SoftPoints(SOFT, SOFT.centres, jnp.ones(len(SOFT.centres)))
    assert (residual_of(energy, BODY, posed) < 0).all()
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(sensitivity(energy, BODY, posed)))
    np.testing.assert_allclose(slopes(sphere(), BODY, posed, jnp.zeros((1, 3))), 0.0, atol=1e-15)


def test_far_away_a_slope_leads_home(rng):
    """Where exponentials themselves have long been zero."""
    rest, middle = rest_pose(SKELETON), jnp.mean(BODY.vertices, 0)
    directions = rng.normal(size=(20, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    for length in (3.0, 300.0):
        points = middle + length * directions
        slope = slopes(SOFT, BODY, rest, points)
        assert (np.sum(slope * directions, 1) > 0.3).all()
        assert (np.linalg.norm(slope, axis=1) < 1.1).all()
        far = distances(SOFT, BODY, rest, points)
        assert (far > 0.3 * length - 1).all()
        assert (far < 1.1 * length).all()


def test_a_saturated_point_pulls_less_than_one_on_the_skin():
    rest = rest_pose(SKELETON)
    points = jnp.array([[0.3, 0, 0], [0.25, 0, 0], [5.0, 0, 0]])
    plain = residual_of(SoftPoints(sphere(), points, jnp.ones(3)), BODY, rest)
    robust = residual_of(SoftPoints(sphere(), points, jnp.ones(3), 0.5), BODY, rest)
    np.testing.assert_allclose(robust, plain / np.sqrt(1 + (plain / 0.5) ** 2), rtol=1e-12)
    assert float(robust[2]) < 0.5
    pulls = np.linalg.norm(
        sensitivity(SoftPoints(sphere(), points, jnp.ones(3), 0.5), BODY, rest).points, axis=1
    )
    assert pulls[2] < 0.01 * pulls[0]


def test_its_reach_in_log_p(rng):
    """Below the least distance by at most `log(P) / stiffness`, and never above it."""
    pose = random_pose(SKELETON, rng, 0.4)
    points = surface_points(pose, rng, 40) + 0.1 * rng.normal(size=(40, 3))
    single = [
        distances(jax.tree.map(lambda x, k=k: x[k : k + 1] if x.ndim else x, SOFT), BODY, pose, points)
        for k in range(len(SOFT.bones))
    ]
    least, found = np.min(single, 0), np.asarray(distances(SOFT, BODY, pose, points))
    assert (found <= least + 1e-12).all()
    assert (found >= least - np.log(len(SOFT.bones)) / float(SOFT.stiffness) - 1e-12).all()


def test_single_precision_is_as_good(rng):
    """Within 2e-6 m and, of the slopes by the pose, 1e-4, for a body of a metre."""
    pose = random_pose(SKELETON, rng, 0.5)
    points = surface_points(pose, rng, 30) + 0.05 * rng.normal(size=(30, 3))
    energy = SoftPoints(SOFT, points, jnp.ones(30), 0.1)
    low = jax.tree.map(
        lambda x: x.astype(jnp.float32) if eqx.is_inexact_array(x) else x, (energy, BODY, pose)
    )
    linearise = eqx.filter_jit(jaxcap.fit.pose_problem.linearise)
    (r_low, j_low), (r, j) = linearise(*low), linearise(energy, BODY, pose)
    assert r_low.dtype == j_low.dtype == jnp.float32
    np.testing.assert_allclose(r_low, r, atol=2e-6)
    np.testing.assert_allclose(j_low, j, atol=1e-4)


def test_a_soft_object_lies_in_the_skin_of_the_human():
    """A man of 1.75 m: within 8 mm in the mean, and neither thinner nor fatter."""
    body = jaxcap.human(resolution="medium")
    soft = make_soft_object(body)
    rest = rest_pose(body.skeleton)
    away = np.asarray(distances(soft, body, rest, body.vertices))
    assert len(soft.bones) < 70
    assert np.abs(away).mean() < 0.008
    assert np.percentile(np.abs(away), 95) < 0.025
    assert abs(away.mean()) < 0.002
    finer = make_soft_object(body, primitives=3, blend=0.02)
    assert np.abs(np.asarray(distances(finer, body, rest, body.vertices))).mean() < 0.008


def test_what_has_no_shape_is_told():
    bare = eqx.tree_at(
        lambda body: (body.vertices, body.skin.bones), BODY, (jnp.zeros((2, 3)), jnp.array([0, 1]))
    )
    bare = eqx.tree_at(lambda body: body.faces, bare, jnp.zeros((0, 3), int))
    with pytest.raises(ValueError, match="no shape"):
        make_soft_object(bare)
    with pytest.raises(ValueError, match="0 primitives"):
        make_soft_object(BODY, 0)
    with pytest.raises(ValueError, match="positive"):
        make_soft_object(BODY, blend=0.0)


def test_points_on_the_skin_are_fitted_back(rng):
    """The chain bends and slides as its points do; only what no point shows stays near rest."""
    truth, start = random_pose(SKELETON, rng, 0.08), rest_pose(SKELETON)
    points = on_skin(SOFT, truth, surface_points(truth, rng, 400))
    prior = RestPrior(jnp.ones((SKELETON.num_joints, 3)))
    found = solve_(SoftPoints(SOFT, points, jnp.ones(400)) + 1e-3 * prior, BODY, start, max_steps=100).pose
    joints = [np.asarray(pose_body(BODY, pose).joints) for pose in (truth, start, found)]
    assert np.linalg.norm(joints[1] - joints[0], axis=1).mean() > 0.04
    assert np.linalg.norm(joints[2] - joints[0], axis=1).mean() < 0.004


def test_points_of_a_surface_with_outliers_bend_its_joint(rng):
    """A bent tube by points of its own triangles, a tenth of them gone astray."""
    body = cylinder("linear")
    turn = rotation.exp(jnp.array([0.0, 0.6, 0.2]))
    rest = rest_pose(body.skeleton)
    truth = eqx.tree_at(lambda pose: pose.rotations, rest, rest.rotations.at[1].set(turn))
    chosen = jnp.asarray(rng.integers(0, len(body.vertices), 300))
    points = pose_body(body, truth).vertices[chosen]
    points = points.at[:30].add(0.3 * rng.normal(size=(30, 3)))
    energy = SoftPoints(make_soft_object(body), points, jnp.ones(300), 0.03)
    found = solve_(energy + 1e-4 * RestPrior(jnp.ones((2, 3))), body, rest, max_steps=100).pose
    assert float(rotation.distance(found.rotations[1], turn)) < np.radians(3)
