"""Even and farthest-point samples by their properties."""

import numpy as np
import pytest
from scipy.spatial.distance import cdist

from jaxcap.geometry.sampling import even_indices, farthest_points


@pytest.mark.parametrize("nearest", [False, True])
@pytest.mark.parametrize(
    ("count", "limit"), [(0, 5), (1, 5), (7, 1), (7, 2), (7, 5), (7, 7), (7, 9), (1000, 64)]
)
def test_even_indices_are_distinct_and_evenly_spread(count, limit, nearest):
    rows = even_indices(count, limit, nearest)
    assert len(rows) == min(count, limit)
    if len(rows) > 1:
        assert (rows[0], rows[-1]) == (0, count - 1)
        steps = np.diff(rows)
        assert steps.min() >= 1 and np.ptp(steps) <= 1 + nearest


def test_farthest_points_cover_all_others(rng):
    points = rng.normal(size=(200, 3))
    chosen = farthest_points(points, 12, 5)
    assert 5 in chosen and len(np.unique(chosen)) == 12 and (np.diff(chosen) > 0).all()
    # Gonzalez 1985: no point is farther from the sample than two of the sample are from each other
    apart = cdist(points[chosen], points[chosen]) + np.diag(np.full(12, np.inf))
    assert cdist(points, points[chosen]).min(1).max() <= apart.min() + 1e-12


def test_farthest_points_leave_out_excluded_and_coincident_points():
    points = np.array([[0.0, 0], [1, 0], [1, 0], [100, 0], [3, 0]])
    outlier = np.arange(5) == 3
    np.testing.assert_array_equal(farthest_points(points, 3, 0, outlier), [0, 1, 4])
    np.testing.assert_array_equal(farthest_points(points, 9, 0, outlier), [0, 1, 4])
    np.testing.assert_array_equal(farthest_points(points, 2, 0), [0, 3])
