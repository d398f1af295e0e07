"""Gaussian mixtures by EM, how many Gaussians there are, and couplings that are taken out."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import multivariate_normal

from jaxcap.prior.covariance_selection import count_zero_couplings, partial_correlations, threshold_couplings
from jaxcap.prior.gaussian_mixture import (
    MIN_DEVIATION,
    GaussianMixture,
    fit_mixture,
    kmeans_labels,
    mixture_log_density,
)
from jaxcap.prior.model_selection import THRESHOLDS, cross_validation_folds, select_mixture


def some_covariance(rng, size: float = 0.3) -> np.ndarray:
    root = rng.normal(size=(6, 6))
    return size**2 * (root @ root.T / 6 + 0.3 * np.eye(6))


def clusters(rng, count: int, samples: int, apart: float = 3.0):
    """Samples in random order, and weights, means and covariances that they are drawn from."""
    weights = rng.dirichlet(np.full(count, 8.0))
    means = apart * np.linalg.qr(rng.normal(size=(6, 6)))[0][:count]
    covariances = np.array([some_covariance(rng) for _ in range(count)])
    labels = rng.choice(count, samples, p=weights)
    drawn = np.array([rng.multivariate_normal(means[k], covariances[k]) for k in labels])
    return drawn, weights, means, covariances


def test_em_recovers_a_known_mixture(rng):
    samples, weights, means, covariances = clusters(rng, 3, 6000)
    mixture, history = fit_mixture(samples, 3)
    order = [int(np.argmin(np.linalg.norm(mixture.means - mean, axis=1))) for mean in means]
    assert sorted(order) == [0, 1, 2]
    np.testing.assert_allclose(mixture.weights[order], weights, atol=0.02)
    np.testing.assert_allclose(mixture.means[order], means, atol=0.04)
    found = np.linalg.inv(mixture.precisions[order])
    np.testing.assert_allclose(found, covariances, atol=0.12 * np.abs(covariances).max())
    assert (np.diff(history) > -1e-12).all()


def test_density_is_that_of_scipy(rng):
    samples, weights, means, covariances = clusters(rng, 3, 50, apart=0.7)
    mixture = GaussianMixture(weights, means, np.linalg.inv(covariances))
    normals = [multivariate_normal(m, c).pdf(samples) for m, c in zip(means, covariances, strict=True)]
    np.testing.assert_allclose(mixture_log_density(mixture, samples), np.log(weights @ normals), atol=1e-11)


def degenerate(rng, kind: int, samples: int) -> np.ndarray:
    """Samples as they should not be: still, on a line, few distinct ones, far apart, with strays."""
    x = 0.3 * rng.normal(size=(samples, 6))
    if kind == 1:
        x[:, :3] = 0.1
    elif kind == 2:
        x = np.zeros((samples, 6))
    elif kind == 3:
        x = rng.normal(size=(samples, 1)) * rng.normal(size=6)
    elif kind == 4:
        x = x[rng.integers(0, 2, samples)]
    elif kind == 5:
        x[0] = 1e3
    elif kind == 6:
        x[:, 3:] = x[:, :3] + 1e-9 * rng.normal(size=(samples, 3))
    return x


@given(
    st.integers(0, 6),
    st.integers(12, 80),
    st.integers(1, 6),
    st.sampled_from(THRESHOLDS),
    st.integers(0, 999),
)
def test_likelihood_never_falls_and_precisions_are_positive_definite(kind, samples, count, threshold, seed):
    x = degenerate(np.random.default_rng(seed), kind, samples)
    mixture, history = fit_mixture(x, count, seed=seed)
    assert np.isfinite(history).all()
    assert (np.diff(history) >= -1e-9 * np.maximum(1.0, np.abs(history[1:]))).all()
    assert mixture.weights.sum() == pytest.approx(1.0)
    assert (mixture.weights > 0).all()
    zeroed = threshold_couplings(mixture, threshold)
    for precisions in (mixture.precisions, zeroed.precisions):
        values = np.linalg.eigvalsh(precisions)
        assert (values > 0).all()
        assert np.isfinite(precisions).all()
    # no component is narrower than the floor
    assert np.linalg.eigvalsh(mixture.precisions).max() <= (1 + 1e-6) / MIN_DEVIATION**2
    np.linalg.cholesky(zeroed.precisions)
    assert np.isfinite(mixture_log_density(zeroed, x)).all()


def test_a_start_where_all_samples_are_the_same():
    labels, apart = kmeans_labels(np.ones((5, 6)), 3, np.random.default_rng(0))
    assert labels.shape == (5,)
    assert apart == 0
    mixture = fit_mixture(np.ones((5, 6)), 3).mixture
    np.testing.assert_allclose(mixture.means, 1.0)


@pytest.mark.parametrize("samples", [71, 400])
def test_one_gaussian_is_one_component(rng, samples):
    """Each pose left out by itself, and blocks of them."""
    x = rng.multivariate_normal(rng.normal(size=6), some_covariance(rng), size=samples)
    chosen = select_mixture(x, max_components=5)
    assert len(chosen.mixture.weights) == 1
    assert np.argmax(chosen.held_out.max(1)) == 0


@pytest.mark.parametrize(("count", "samples"), [(2, 40), (3, 60), (2, 300), (3, 300)])
def test_separate_clusters_are_as_many_components(rng, count, samples):
    x = clusters(rng, count, samples)[0]
    chosen = select_mixture(x, max_components=6)
    assert len(chosen.mixture.weights) == count
    assert chosen.best_log_likelihood > chosen.single_log_likelihood + 0.5


def test_zeroing_keeps_couplings_that_are_there_and_gains_likelihood(rng):
    """Three independent pairs of coupled numbers, seen in few samples: what couples the pairs is chance."""
    covariance = 0.04 * np.kron(np.eye(3), [[1.0, 0.8], [0.8, 1.0]])
    gains = []
    for _ in range(10):
        x = rng.multivariate_normal(np.zeros(6), covariance, size=60)
        test = rng.multivariate_normal(np.zeros(6), covariance, size=2000)
        whole = fit_mixture(x, 1).mixture
        zeroed = threshold_couplings(whole, 0.4)
        gains.append(mixture_log_density(zeroed, test).mean() - mixture_log_density(whole, test).mean())
    assert np.mean(gains) > 0.05
    chosen = select_mixture(x, max_components=2)
    assert chosen.threshold > 0
    assert chosen.held_out[0].max() > chosen.single_log_likelihood
    couplings = partial_correlations(chosen.mixture.precisions[0])
    assert (couplings[[0, 2, 4], [1, 3, 5]] > 0.5).all()
    assert count_zero_couplings(chosen.mixture.precisions)[0] >= 6


def test_couplings_that_cannot_be_zero_are_lowered():
    """Of this matrix the weaker couplings hold the stronger up: without them it is not positive definite."""
    strong, weak = 0.9, 0.7
    precision = np.eye(6)
    precision[0, 1] = precision[1, 0] = precision[0, 2] = precision[2, 0] = strong
    precision[1, 2] = precision[2, 1] = weak
    mixture = GaussianMixture(np.ones(1), np.zeros((1, 6)), precision[None])
    assert np.linalg.eigvalsh(precision)[0] > 0
    plain = np.where(np.abs(precision) < 0.8, 0.0, precision)
    assert np.linalg.eigvalsh(plain)[0] < 0
    found = threshold_couplings(mixture, 0.8).precisions[0]
    assert 0 < found[1, 2] < weak
    assert found[0, 1] == found[0, 2] == strong
    np.testing.assert_allclose(found, found.T)
    assert np.linalg.eigvalsh(found)[0] >= 0.099 * np.linalg.eigvalsh(precision)[0]
    np.testing.assert_allclose(threshold_couplings(mixture, 1.01).precisions[0], np.eye(6))
    np.testing.assert_array_equal(threshold_couplings(mixture, 0.0).precisions[0], precision)


def test_many_poses_are_left_out_in_blocks():
    np.testing.assert_array_equal(cross_validation_folds(5), np.arange(5))
    folds = cross_validation_folds(1000)
    assert (np.diff(folds) >= 0).all()
    assert (np.bincount(folds) == 100).all()


def test_what_is_refused(rng):
    with pytest.raises(ValueError, match="4 components cannot be fitted to 3 samples"):
        fit_mixture(np.zeros((3, 6)), 4)
    with pytest.raises(ValueError, match="not finite"):
        fit_mixture(np.full((9, 6), np.nan), 1)
    with pytest.raises(ValueError, match="There are 3 poses"):
        select_mixture(np.zeros((3, 6)))
