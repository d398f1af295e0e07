"""Deviations of priors by the marginal likelihood."""

import jax.numpy as jnp
import numpy as np
import scipy.optimize

from jaxcap.markers.calibration.calibration_parameters import PriorGroups
from jaxcap.markers.calibration.prior_scales import next_variances, scaled_groups, slide_variances
from jaxcap.markers.calibration.soft_tissue import relative_modes
from tests.markers_limb import truth

SUBJECT = truth()


def _posterior(design, data, variances):
    """Compute means and covariance of `z` in `data = design @ z + unit noise`, with prior `variances` of `z`."""
    covariance = np.linalg.inv(design.T @ design + np.diag(1.0 / variances))
    return covariance @ design.T @ data, covariance


def test_the_update_converges_to_a_maximum_of_the_marginal_likelihood(rng):
    design = rng.normal(size=(40, 12))
    groups = np.repeat([0, 1], 6)
    data = design @ (rng.normal(size=12) * np.array([0.4, 2.0])[groups]) + rng.normal(size=40)

    def negative_log_likelihood(log_variance):
        covariance = design @ np.diag(np.exp(log_variance)[groups]) @ design.T + np.eye(40)
        return np.linalg.slogdet(covariance)[1] + data @ np.linalg.solve(covariance, data)

    best = np.exp(scipy.optimize.minimize(negative_log_likelihood, np.zeros(2)).x)
    variances = jnp.ones(2)
    for _ in range(300):
        means, covariance = _posterior(design, data, np.asarray(variances)[groups])
        variances = next_variances(
            jnp.asarray(means), jnp.diag(covariance), jnp.asarray(groups), variances[groups], 2, 1.0, 0.0
        )
    np.testing.assert_allclose(variances, best, rtol=1e-3)


def test_numbers_without_data_have_no_influence(rng):
    design = np.concatenate([rng.normal(size=(30, 5)), np.zeros((30, 50))], 1)
    data = design[:, :5] @ (0.5 * rng.normal(size=5)) + rng.normal(size=30)
    results = []
    for count in (5, 55):
        means, covariance = _posterior(design[:, :count], data, np.ones(count))
        groups = np.zeros(count, int)
        results.append(
            next_variances(
                jnp.asarray(means), jnp.diag(covariance), jnp.asarray(groups), jnp.ones(count), 1, 1.0, 2.0
            )
        )
    np.testing.assert_allclose(*results, rtol=1e-9)


def test_scaled_groups_divide_the_deviations(rng):
    rows = rng.normal(size=(6, 4))
    groups = scaled_groups(PriorGroups(rows, np.array([0, 0, 1, 1, 1, 0])), float)
    np.testing.assert_allclose(groups.precision(), rows.T @ rows, atol=1e-12)
    wider = type(groups)(groups.rows, groups.groups, jnp.array([2.0, 1.0]))
    weights = np.array([4.0, 4.0, 1.0, 1.0, 1.0, 4.0])
    np.testing.assert_allclose(wider.precision(), rows.T @ (rows / weights[:, None]), atol=1e-12)


def test_each_bone_and_feature_has_its_own_variance_of_slides(rng):
    bones = np.repeat([0, 3], 40)
    true = np.array([[0.01, 0.01], [0.002, 0.01], [0.01, 0.03]])
    slides = rng.normal(size=(3, 80, 3)) * np.repeat(true, 40, 1)[..., None]
    modes, old = jnp.eye(240), jnp.full((3, 240), 1e-4)
    found = slide_variances(
        jnp.asarray(slides), jnp.zeros((3, 240, 240)), modes, jnp.asarray(np.repeat(bones, 3)), old, 4
    )
    np.testing.assert_allclose(np.sqrt(found)[:, [0, 3]], true, rtol=0.25)


def test_relative_modes_are_no_rigid_motion(rng):
    modes = relative_modes(SUBJECT)
    np.testing.assert_allclose(modes.rows @ modes.rows.T, np.eye(len(modes.rows)), atol=1e-12)
    bones, offsets = np.asarray(SUBJECT.bones), np.asarray(SUBJECT.offsets)
    for bone in np.unique(bones):
        own = (bones == bone)[:, None]
        moved = own * (rng.normal(size=3) + np.cross(rng.normal(size=3), offsets))
        np.testing.assert_allclose(modes.rows @ moved.ravel(), 0, atol=1e-9)
        assert np.sum(modes.bones == bone) == 3 * own.sum() - 6
