"""Small and sparse linear equations against SciPy, and against what the answers have to satisfy."""

import numpy as np
import pytest
import scipy.linalg
import scipy.sparse
from hypothesis import given, settings
from hypothesis import strategies as st

from jaxcap.geometry import linear


def spread(rng, count, size, digits, indefinite=False):
    """Symmetric matrices whose numbers have units some powers of ten apart."""
    turns = np.linalg.qr(rng.normal(size=(count, size, size)))[0]
    values = rng.uniform(1.0, 3.0, (count, size))
    if indefinite:
        values[:, ::2] *= -1
    units = 10.0 ** rng.uniform(-digits, digits, (count, size))
    even = np.einsum("nij,nj,nkj->nik", turns, values, turns)
    return units[:, :, None] * 0.5 * (even + even.swapaxes(1, 2)) * units[:, None, :]


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(1, 7), st.sampled_from([0, 4, 7]), st.booleans())
def test_symmetric_equations_are_met_whatever_the_units(seed, size, digits, indefinite):
    rng = np.random.default_rng(seed)
    matrix = spread(rng, 3, size, digits, indefinite)
    known = rng.normal(size=(3, size)) / np.sqrt(np.abs(np.diagonal(matrix, axis1=1, axis2=2)))
    side = np.einsum("nij,nj->ni", matrix, known)
    found = linear.solve_symmetric(matrix, side)
    terms = np.einsum("nij,nj->ni", np.abs(matrix), np.abs(found))
    assert (np.abs(np.einsum("nij,nj->ni", matrix, found) - side) <= 1e-11 * terms).all()
    inverse = linear.inverse_symmetric(matrix)
    np.testing.assert_array_equal(inverse, inverse.swapaxes(1, 2))
    terms = np.abs(matrix) @ np.abs(inverse)
    assert (np.abs(matrix @ inverse - np.eye(size)) <= 1e-11 * terms + 1e-13).all()


def test_what_is_hardly_known_is_not_lost_beside_what_is_known_well():
    # exact numbers: variances of 1e-16 and 1e16 that go together by a half
    covariance = np.array([[1e-16, 0.5], [0.5, 1e16]])
    expected = np.array([[1e16, -0.5], [-0.5, 1e-16]]) / 0.75
    np.testing.assert_allclose(linear.inverse_symmetric(covariance), expected, rtol=1e-14)


def test_stacks_agree_with_scipy(rng):
    matrix, side = rng.normal(size=(4, 2, 5, 5)), rng.normal(size=(4, 2, 5))
    found, inverse = linear.solve_square(matrix, side), linear.inverse(matrix)
    positive = matrix @ matrix.swapaxes(-1, -2)
    factor = linear.factor_symmetric(positive)
    for place in np.ndindex(4, 2):
        np.testing.assert_allclose(found[place], scipy.linalg.solve(matrix[place], side[place]), rtol=1e-9)
        np.testing.assert_allclose(inverse[place], scipy.linalg.inv(matrix[place]), rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(
            factor[place], scipy.linalg.cholesky(positive[place], lower=True), atol=1e-9
        )
    assert (np.triu(factor, 1) == 0).all()


@pytest.mark.parametrize("verb", [linear.inverse, linear.inverse_symmetric, linear.factor_symmetric])
def test_singular_matrices_are_refused(verb):
    with pytest.raises(np.linalg.LinAlgError):
        verb(np.diag([1.0, 0.0, 2.0]))


def test_singular_equations_and_indefinite_factors_are_refused():
    singular = np.array([[1.0, 1.0], [1.0, 1.0]])
    for verb in (linear.solve_square, linear.solve_symmetric):
        with pytest.raises(np.linalg.LinAlgError):
            verb(singular, np.ones(2))
    with pytest.raises(np.linalg.LinAlgError):
        linear.factor_symmetric(np.array([[1.0, 2.0], [2.0, 1.0]]))
    with pytest.raises(RuntimeError):
        linear.factor_sparse(scipy.sparse.csc_array(singular))


@pytest.mark.parametrize(("rows", "count"), [(9, 4), (3, 6)])
def test_least_squares_leaves_nothing_along_the_rows(rng, rows, count):
    matrix, side = rng.normal(size=(rows, count)), rng.normal(size=rows)
    found = linear.least_squares(matrix, side)
    np.testing.assert_allclose(matrix.T @ (matrix @ found - side), 0, atol=1e-12)
    # the shortest of all: no part of it in what the rows do not see
    np.testing.assert_allclose(scipy.linalg.null_space(matrix).T @ found, 0, atol=1e-12)


def test_a_sparse_factor_serves_many_sides(rng):
    matrix = scipy.sparse.csc_array(2.01 * np.eye(200) - np.eye(200, k=1) - np.eye(200, k=-1))
    side = rng.normal(size=(200, 3))
    factor = linear.factor_sparse(matrix)
    expected = scipy.linalg.solve(matrix.toarray(), side)
    np.testing.assert_allclose(factor.solve(side), expected, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(factor.solve(side[:, 0].copy()), expected[:, 0], rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("rank", [1, 3, 5])
def test_low_rank_factors_are_the_best_ones_in_their_metric(rng, rank):
    matrix, root = rng.normal(size=(30, 5)), rng.normal(size=(5, 5))
    metric = root @ root.T + 0.1 * np.eye(5)
    left, right = linear.low_rank_factors(matrix, metric, rank)
    assert left.shape == (30, rank) and right.shape == (rank, 5)
    # Eckart and Young: what is lost are the smallest singular values of the whitened matrix
    whitened = np.linalg.svd(matrix @ scipy.linalg.sqrtm(metric), compute_uv=False)
    lost = matrix - left @ right
    np.testing.assert_allclose(np.trace(lost @ metric @ lost.T), np.sum(whitened[rank:] ** 2), atol=1e-10)
