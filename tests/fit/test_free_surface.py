"""Surfaces with free vertices: the prior of displacements, the equations, and the registration to scans."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import trimesh

import jaxcap as jc
from jaxcap.energy.data.pairs import PointPairs
from jaxcap.fit.correspondence.nearest_assignment import IndexedScan, make_scan
from jaxcap.fit.free_surface.displacement_prior import make_displacement_prior
from jaxcap.fit.free_surface.free_surface_problem import FreeSurfaceProblem
from jaxcap.fit.free_surface.register_surface import estimate_deviation, register_surface
from jaxcap.fit.free_surface.vertex_couplings import find_couplings
from jaxcap.geometry.mesh import sample_surface

RADIUS, DEVIATION, LENGTH = 0.3, 0.01, 0.1
SPHERE = trimesh.creation.icosphere(subdivisions=3, radius=RADIUS)
VERTICES, FACES = np.asarray(SPHERE.vertices, float), np.asarray(SPHERE.faces, int)
PRIOR = make_displacement_prior(VERTICES, FACES, DEVIATION, LENGTH)


def bumpy(points):
    """Move points of the sphere out by a bump at the top, and everything sideways."""
    near = np.exp(-np.sum((points - [0.0, RADIUS, 0.0]) ** 2, 1) / (2 * 0.12**2))
    return points + 0.015 * near[:, None] * points / RADIUS + [0.004, 0.0, 0.0]


def scan_of(vertices, faces, count=6000, noise=0.002, kept=lambda points: points[:, 0] < 9.0) -> IndexedScan:
    rng = np.random.default_rng(1)
    points, normals = sample_surface(vertices, faces, count, rng)
    keep = kept(points)
    points = points + noise * rng.normal(size=points.shape)
    return make_scan(jc.make_cloud(points[keep], normals[keep]))


def test_the_prior_has_its_deviation_and_its_correlation():
    """Against the series of spherical harmonics of the same field on a sphere."""
    length = 0.2
    prior = make_displacement_prior(VERTICES, FACES, DEVIATION, length)
    rows = np.asarray(prior.residual(jnp.eye(len(VERTICES))))
    np.testing.assert_allclose(prior.precision(jnp.eye(len(VERTICES))), rows.T @ rows, atol=1e-6)
    np.testing.assert_allclose(prior.diagonal, np.diag(rows.T @ rows))
    covariance = np.linalg.inv(rows.T @ rows)
    degrees, frequency = np.arange(200), np.sqrt(8) / length
    powers = (2 * degrees + 1) / (frequency**2 + degrees * (degrees + 1) / RADIUS**2) ** 2
    cosines = VERTICES @ VERTICES[0] / RADIUS**2
    truth = DEVIATION**2 * (frequency / RADIUS) ** 2 * np.polynomial.legendre.legval(cosines, powers)
    # lumped masses overestimate the variance itself on a coarse mesh
    np.testing.assert_allclose(covariance[0, 1:], truth[1:], atol=0.02 * truth[0])
    assert covariance[0, 0] == pytest.approx(truth[0], rel=0.1)
    # on a sphere much larger than the length it is the given deviation
    assert np.sqrt(truth[0]) == pytest.approx(DEVIATION, rel=0.05)


def test_one_step_solves_the_equations():
    """Against dense least squares of the written-out residuals."""
    rng = np.random.default_rng(0)
    chosen = FACES[rng.integers(len(FACES), size=50)]
    normals = rng.normal(size=(50, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    shares = rng.dirichlet(np.ones(3), 50)
    points = np.einsum("ck,cka->ca", shares, VERTICES[chosen]) + 0.01 * rng.normal(size=(50, 3))
    pairs = PointPairs(
        jnp.asarray(chosen),
        *(jnp.asarray(x) for x in (shares, points, normals)),
        jnp.full(50, 1e5),
        jnp.full(50, 0.3),
    )
    couplings = find_couplings(FACES, len(VERTICES), pairs)
    problem = FreeSurfaceProblem(jnp.asarray(VERTICES), pairs, couplings, PRIOR, jnp.asarray(1e-10))
    zero = jnp.zeros(VERTICES.shape)
    info = jax.jit(lambda p: p.information(zero))(problem)
    step = info.hessian.factorise().solve(-info.grad)
    # rows: across and along every pair, then the prior
    project = np.eye(3) - normals[:, :, None] * normals[:, None]
    weights = np.sqrt(1e5) * (normals[:, :, None] * normals[:, None] + np.sqrt(0.3) * project)
    jacobian = np.zeros((50, 3, len(VERTICES), 3))
    for k in range(3):
        np.add.at(jacobian, (np.arange(50), slice(None), chosen[:, k]), shares[:, k, None, None] * weights)
    gaps = np.einsum("ck,cka->ca", shares, VERTICES[chosen]) - points
    root = np.asarray(PRIOR.residual(jnp.eye(len(VERTICES))))
    matrix = np.concatenate([jacobian.reshape(150, -1), np.kron(root, np.eye(3))])
    side = -np.concatenate([np.einsum("cab,cb->ca", weights, gaps).ravel(), np.zeros(VERTICES.size)])
    truth = np.linalg.lstsq(matrix, side, rcond=None)[0].reshape(-1, 3)
    np.testing.assert_allclose(step, truth, atol=1e-7)
    assert float(info.f) == pytest.approx(0.5 * np.sum(side**2))


def test_vertices_meet_the_surface_below_its_noise():
    found = register_surface(VERTICES, FACES, scan_of(bumpy(VERTICES), FACES), PRIOR)
    away = trimesh.proximity.closest_point(trimesh.Trimesh(bumpy(VERTICES), FACES), found.vertices)[1]
    assert np.median(away) < 0.001 and away.max() < 0.005
    assert found.seen.all() and found.explained > 0.99
    assert found.sigma == pytest.approx(0.002, rel=0.15)


def test_what_the_scan_does_not_show_stays_at_the_guide():
    half = scan_of(bumpy(VERTICES) + [0.0, 0.0, 0.005], FACES, kept=lambda points: points[:, 0] > 0.0)
    found = register_surface(VERTICES, FACES, half, PRIOR)
    x = VERTICES[:, 0]
    assert found.seen[x > 0.03].all() and not found.seen[x < -0.03].any()
    assert np.isnan(found.distances[~found.seen]).all() and np.isfinite(found.distances[found.seen]).all()
    moved = np.linalg.norm(found.vertices - VERTICES, axis=1)
    assert moved[x < -2 * LENGTH].max() < 0.001 < 0.003 < np.median(moved[x > 0.05])


def test_the_deviation_of_the_guide_is_found_below_the_noise():
    """Of a scan 5 mm outside of the guide, and of one at the guide, with 2 mm of noise in both."""
    outside = scan_of(VERTICES * (1 + 0.005 / RADIUS), FACES)
    assert estimate_deviation(VERTICES, FACES, outside) == pytest.approx(0.005, rel=0.05)
    assert estimate_deviation(VERTICES, FACES, scan_of(VERTICES, FACES)) < 0.0007
    far = scan_of(VERTICES + [2.0, 0.0, 0.0], FACES, count=500)
    assert estimate_deviation(VERTICES, FACES, far) == 0.0005


def test_points_of_another_surface_do_not_pull():
    """A second sheet faces the other way, and another object is out of reach."""
    own = scan_of(bumpy(VERTICES), FACES)
    inside, normals = sample_surface(0.95 * bumpy(VERTICES), FACES, 3000, np.random.default_rng(2))
    points = np.concatenate([own.points, inside, inside + [0.8, 0.0, 0.0]])
    mixed = make_scan(jc.make_cloud(points, np.concatenate([own.normals, -normals, normals])))
    found = register_surface(VERTICES, FACES, mixed, PRIOR)
    away = trimesh.proximity.closest_point(trimesh.Trimesh(bumpy(VERTICES), FACES), found.vertices)[1]
    assert np.median(away) < 0.001
    assert found.explained == pytest.approx(0.5, abs=0.02)


def test_nothing_in_reach_leaves_the_guide():
    far = scan_of(VERTICES + [2.0, 0.0, 0.0], FACES, count=500)
    found = register_surface(VERTICES, FACES, far, PRIOR)
    np.testing.assert_allclose(found.vertices, VERTICES, atol=1e-12)
    assert not found.seen.any() and found.explained == 0.0
