"""Least squares over the simplex against every support in turn, and against SciPy."""

import itertools

import jax.numpy as jnp
import numpy as np
import pytest
import scipy.optimize

from jaxcap.fit.solvers.simplex_least_squares import largest_weights, simplex_least_squares


def problems(rng, width: int, count: int = 40):
    """Images from well to badly conditioned, targets inside and outside of what they reach."""
    images = rng.normal(size=(count, 12, width))
    images[: count // 2] *= np.logspace(0, -4, width)
    images[0, :, 1] = images[0, :, 0]
    images[1, :, 0] = 0.0
    targets = 2 * rng.normal(size=(count, 12))
    inside = rng.dirichlet(0.3 * np.ones(width), count // 4)
    targets[-len(inside) :] = np.einsum("nfk,nk->nf", images[-len(inside) :], inside)
    gram = np.einsum("nfi,nfj->nij", images, images)
    return gram, np.einsum("nfi,nf->ni", images, targets)


def value(gram, linear, weights):
    return weights @ gram @ weights - 2 * linear @ weights


def least_value(gram, linear) -> float:
    """The minimum by trying every set of weights that are not zero."""
    best = np.inf
    for size in range(1, len(linear) + 1):
        for support in itertools.combinations(range(len(linear)), size):
            rows = np.array(support)
            system = np.block(
                [[gram[np.ix_(rows, rows)], np.ones((size, 1))], [np.ones((1, size)), np.zeros((1, 1))]]
            )
            solved = np.linalg.lstsq(system, np.append(linear[rows], 1.0), rcond=None)[0][:size]
            if solved.min() >= 0:
                weights = np.zeros(len(linear))
                weights[rows] = solved
                best = min(best, value(gram, linear, weights))
    return best


@pytest.mark.parametrize("width", [2, 3, 6])
def test_the_minimum_is_that_of_every_support_in_turn(rng, width):
    gram, linear = problems(rng, width)
    start = np.eye(width)[rng.integers(width, size=len(linear))]
    weights = np.asarray(simplex_least_squares(jnp.asarray(gram), jnp.asarray(linear), jnp.asarray(start)))
    assert weights.min() >= 0
    np.testing.assert_allclose(weights.sum(1), 1, atol=1e-12)
    for i in range(len(linear)):
        assert value(gram[i], linear[i], weights[i]) <= least_value(gram[i], linear[i]) + 1e-9


def test_groups_sum_to_one_each_and_forbidden_weights_stay_zero(rng):
    gram, linear = problems(rng, 5, 12)
    groups, allowed = (0, 0, 1, 1, 1), np.ones((12, 5), bool)
    allowed[:, 3] = False
    start = np.tile([1.0, 0, 1.0, 0, 0], (12, 1))
    weights = np.asarray(
        simplex_least_squares(*(jnp.asarray(a) for a in (gram, linear, start, allowed)), groups=groups)
    )
    np.testing.assert_allclose([weights[:, :2].sum(1), weights[:, 2:].sum(1)], 1, atol=1e-12)
    assert (weights[:, 3] == 0).all() and weights.min() >= 0
    sums = [{"type": "eq", "fun": lambda w, s=s: w[s].sum() - 1} for s in (slice(0, 2), slice(2, 5))]
    bounds = [(0, 1)] * 3 + [(0, 0)] + [(0, 1)]
    for i in range(6, 12):
        found = scipy.optimize.minimize(
            lambda w, i=i: value(gram[i], linear[i], w),
            start[i],
            bounds=bounds,
            constraints=sums,
            method="SLSQP",
            options={"ftol": 1e-12, "maxiter": 500},
        )
        assert value(gram[i], linear[i], weights[i]) <= found.fun + 1e-7


def test_largest_weights_marks_exactly_so_many():
    weights = jnp.array([[0.25, 0.25, 0.25, 0.25], [0.1, 0.0, 0.6, 0.3]])
    np.testing.assert_array_equal(
        largest_weights(weights, 2), [[True, True, False, False], [False, False, True, True]]
    )


def test_images_that_cancel_exactly_give_finite_weights(rng):
    """A vertex that is explained exactly has a singular matrix, whose pivots round to zero or less."""
    count = 3000
    image = rng.normal(size=(count, 42))
    share = rng.uniform(0.05, 0.95, (count, 1))
    images = np.stack([(1 - share) * image, -share * image, rng.normal(size=(count, 42))], 1)
    gram = images @ images.transpose(0, 2, 1)
    # rounding as of longer sums
    noise = 4 * np.finfo(float).eps * rng.normal(size=gram.shape)
    gram = jnp.asarray(gram * (1 + noise + noise.transpose(0, 2, 1)))
    start = np.concatenate([share, 1 - share, np.full((count, 1), 1e-8)], 1)
    start = jnp.asarray(start / start.sum(1, keepdims=True))
    found = np.asarray(simplex_least_squares(gram, jnp.zeros((count, 3)), start))
    np.testing.assert_allclose(found, np.concatenate([share, 1 - share, np.zeros((count, 1))], 1), atol=1e-6)
