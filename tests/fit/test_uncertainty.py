"""Covariance against Monte Carlo, and directions that the data do not show."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import chain_body, random_pose

from jaxcap.body.body import pose_body
from jaxcap.body.pose import rest_pose
from jaxcap.body.retraction import difference, retract
from jaxcap.body.skeleton import dof_layout
from jaxcap.energy.data.landmarks import VertexLandmarks
from jaxcap.energy.data.points import PointToPlane
from jaxcap.energy.priors.reference_pose import RestPrior
from jaxcap.fit.linearise import linearise
from jaxcap.fit.pose_problem import PoseProblem
from jaxcap.fit.solve import solve
from jaxcap.fit.solvers.gauss_newton import GaussNewton
from jaxcap.fit.uncertainty import describe_unobservable, uncertainty

BODY = chain_body("rigid")
SKELETON = BODY.skeleton
LAYOUT = dof_layout(SKELETON)
NOISE = 0.004
SOLVER = GaussNewton(rtol=1e-12, atol=1e-9)


def landmarks(pose, seen=None) -> VertexLandmarks:
    vertices = jnp.arange(len(BODY.vertices))
    weights = jnp.ones(len(vertices)) if seen is None else jnp.asarray(seen, float)
    return VertexLandmarks(vertices, pose_body(BODY, pose).vertices, weights)


@eqx.filter_jit
def solve_all(energy, truth, noises):
    """The error of the pose for each `(S, V, 3)` of noise on the landmarks, as tangents."""

    def one(noise):
        noisy = eqx.tree_at(lambda e: e.targets, energy, energy.targets + noise)
        return difference(SKELETON, truth, solve(noisy, BODY, truth, SOLVER, 16).pose)

    return jax.lax.map(one, noises)


def test_the_covariance_is_the_spread_of_many_solves(rng):
    truth = random_pose(SKELETON, rng, 0.3)
    energy = landmarks(truth)
    count = 500
    errors = np.asarray(solve_all(energy, truth, NOISE * rng.normal(size=(count, *energy.targets.shape))))
    covariance = np.asarray(uncertainty(energy, BODY, truth, variance=NOISE**2).covariance)
    np.testing.assert_allclose(np.sqrt(np.mean(errors**2, 0)), np.sqrt(np.diag(covariance)), rtol=0.15)
    # correlations too: whitened errors are independent with deviation one
    white = np.linalg.solve(np.linalg.cholesky(covariance), errors.T)
    np.testing.assert_allclose(white @ white.T / count, np.eye(len(covariance)), atol=5 / np.sqrt(count))


def test_the_noise_is_estimated_from_what_is_left_over(rng):
    truth = random_pose(SKELETON, rng, 0.3)
    energy = landmarks(truth)
    noisy = eqx.tree_at(
        lambda e: e.targets, energy, energy.targets + NOISE * rng.normal(size=energy.targets.shape)
    )
    pose = eqx.filter_jit(solve)(noisy, BODY, truth, SOLVER, 16).pose
    estimated = uncertainty(noisy, BODY, pose).covariance
    known = uncertainty(noisy, BODY, pose, variance=1.0).covariance
    ratio = np.asarray(estimated / known)
    np.testing.assert_allclose(ratio, ratio[0, 0], rtol=1e-9)
    # 144 numbers less 22 unknowns: a deviation of 6 %
    assert np.sqrt(ratio[0, 0]) == pytest.approx(NOISE, rel=0.2)


def test_well_shown_poses_have_no_unseen_direction(rng):
    found = uncertainty(landmarks(random_pose(SKELETON, rng, 0.3)), BODY, random_pose(SKELETON, rng, 0.3))
    assert not found.unobservable.any()
    assert describe_unobservable(SKELETON, found) == []
    assert (np.diff(found.curvatures) >= 0).all()


def test_sliding_along_a_plane_is_not_shown_by_point_to_plane():
    """Planes all alike: two shifts of the root along them and the turn about their normal."""
    rest = rest_pose(SKELETON)
    root = jnp.flatnonzero(BODY.skin.dominant_bones() <= 2, size=16)
    up = jnp.broadcast_to(jnp.array([0.0, 0.0, 1.0]), (16, 3))
    count = SKELETON.num_dofs
    energy = PointToPlane(root, BODY.vertices[root], up, jnp.ones(16))
    found = uncertainty(energy, BODY, rest, variance=1.0)
    null = np.asarray(found.directions)[:, np.asarray(found.unobservable)]
    scales = np.asarray(PoseProblem(energy, BODY).scales())
    for slot in (LAYOUT.translations[0, 0], LAYOUT.translations[0, 1], LAYOUT.rotations[0, 2]):
        slide = np.eye(count)[slot]
        # within the span of what is said to be unseen, and unseen indeed
        assert np.linalg.norm(null.T @ slide) == pytest.approx(1.0, abs=1e-6)
        moved = pose_body(BODY, retract(SKELETON, rest, jnp.asarray(1e-3 * slide)))
        np.testing.assert_allclose(energy.residual(moved), 0.0, atol=1e-12)
        assert np.isinf(found.covariance[slot, slot])
    across = np.eye(count)[LAYOUT.translations[0, 2]]
    assert np.linalg.norm(null.T @ across) < 0.9
    text = " ".join(describe_unobservable(SKELETON, found))
    for name in ("root.tx", "root.ty", "root.rz"):
        assert name in text
    # and a step along any unseen direction changes nothing, to first order
    _, jacobian = linearise(energy, BODY, rest)
    np.testing.assert_allclose(jacobian @ (scales[:, None] * null), 0.0, atol=1e-3)


def test_joints_without_data_are_named(rng):
    """The turns of hand and elbow show nowhere but in the vertices beyond them."""
    pose = random_pose(SKELETON, rng, 0.3)
    elbow = SKELETON.index("elbow")
    beyond = np.asarray(SKELETON.descendants)[elbow][np.asarray(BODY.skin.dominant_bones())]
    assert beyond.any()
    seen = ~beyond
    found = uncertainty(landmarks(pose, seen), BODY, pose)
    below = np.isin(LAYOUT.joints, np.flatnonzero(SKELETON.descendants[elbow]))
    # one for the elbow, three for the hand, none for the fixed tool
    assert below.sum() == 4
    null = np.asarray(found.directions)[:, np.asarray(found.unobservable)]
    for slot in np.flatnonzero(below):
        assert np.linalg.norm(null[slot]) == pytest.approx(1.0, abs=1e-9)
    lines = describe_unobservable(SKELETON, found)
    assert len(lines) == null.shape[1]
    assert all(line.startswith("The data do not determine ") and line.endswith(".") for line in lines)
    named = " ".join(lines)
    assert "elbow.rx" in named
    assert "hand.r" in named
    assert "chest" not in named
    assert "jaw" not in named


def test_vague_priors_beside_precise_data_are_resolved_in_float32(rng):
    """A hand that only a prior of 0.5 radians determines, beside landmarks of a millimetre."""
    body = jax.tree.map(lambda x: x.astype(jnp.float32) if eqx.is_inexact_array(x) else x, BODY)
    rest = rest_pose(body.skeleton)
    seen = np.flatnonzero(np.asarray(body.skin.dominant_bones()) <= 2)
    marks = VertexLandmarks(jnp.asarray(seen), body.vertices[seen], jnp.full(len(seen), 1e6, jnp.float32))
    prior = RestPrior(jnp.full((SKELETON.num_joints, 3), 0.5, jnp.float32))
    found = uncertainty(marks + prior, body, rest, variance=1.0)
    hand = LAYOUT.rotations[SKELETON.index("hand"), 0]
    assert float(jnp.sqrt(found.covariance[hand, hand])) == pytest.approx(0.5, rel=1e-3)
    # and without the prior nothing is known of it
    assert jnp.isinf(uncertainty(marks, body, rest, variance=1.0).covariance[hand, hand])


def test_a_covariance_has_the_derivatives_of_differences(rng):
    """Also where curvatures are equal, as of a body at rest whose limbs are alike, where eigenvectors have none."""
    energy = landmarks(rest_pose(SKELETON))

    @eqx.filter_jit
    def spread(weights):
        weighted = eqx.tree_at(lambda e: e.weights, energy, weights)
        return jnp.log(
            jnp.trace(uncertainty(weighted, BODY, rest_pose(SKELETON), variance=NOISE**2).covariance)
        )

    weights = energy.weights
    slope = eqx.filter_jit(jax.grad(spread))(weights)
    for vertex in (3, 40):
        step = 1e-4 * (jnp.arange(len(weights)) == vertex)
        difference = float(spread(weights + step) - spread(weights - step)) / 2e-4
        assert float(slope[vertex]) == pytest.approx(difference, rel=1e-5)
    # scaling all weights scales the covariance: Euler's theorem
    assert float(slope @ weights) == pytest.approx(-1.0, rel=1e-8)


def test_unobservable_coordinates_leave_the_other_derivatives_finite():
    """A row of markers on one bone: what it does not determine is infinite, and the rest has derivatives."""
    few = landmarks(rest_pose(SKELETON), np.arange(len(BODY.vertices)) < 12)

    def spread(weight):
        variances = jnp.diag(
            uncertainty(weight * few, BODY, rest_pose(SKELETON), variance=NOISE**2).covariance
        )
        return jnp.sum(jnp.where(jnp.isfinite(variances), variances, 0.0))

    value, slope = jax.value_and_grad(spread)(2.0)
    assert float(value) > 0.0
    assert float(slope) == pytest.approx(-float(value) / 2.0, rel=1e-8)
