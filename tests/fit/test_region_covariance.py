"""Covariances from regions against that of linear least squares with independent errors."""

import numpy as np
import pytest

from jaxcap.fit.body_models.region_covariance import (
    NUM_REGIONS,
    RegionEquations,
    coefficient_covariance,
    eliminate_pose,
)

NOISE = 1e-3


def fitted(rows: np.ndarray, regions: np.ndarray, rng) -> tuple[np.ndarray, np.ndarray]:
    """Reported and true standard deviations of the coefficients of a fit to noise; the pose has one coordinate, the first."""
    noise = NOISE * rng.normal(size=len(rows))
    residual = noise - rows @ np.linalg.lstsq(rows, noise, rcond=None)[0]
    sides = np.zeros((NUM_REGIONS, rows.shape[1]))
    np.add.at(sides, regions, residual[:, None] * rows)
    frame = RegionEquations(rows.T @ rows, sides, float(residual @ residual), len(rows))
    found = coefficient_covariance([eliminate_pose(frame, rows.shape[1] - 1)])
    return np.sqrt(np.diagonal(found)), NOISE * np.sqrt(np.diagonal(np.linalg.inv(rows.T @ rows)))[1:]


@pytest.mark.parametrize("seen", [1, 2, 6])
def test_a_coefficient_that_few_regions_determine_has_its_deviation(seen):
    rng = np.random.default_rng(0)
    regions = np.repeat(np.arange(NUM_REGIONS), 60)
    rows = rng.normal(size=(len(regions), 4))
    rows[regions >= seen, 3] = 0.0
    found, true = fitted(rows, regions, rng)
    # in single fits the regions may spread by more
    assert found[2] > 0.95 * true[2] and (found < 1.6 * true).all()


def test_more_coefficients_than_regions_have_deviations_in_every_direction():
    rng = np.random.default_rng(1)
    regions = np.repeat(np.arange(NUM_REGIONS), 12)
    rows = rng.normal(size=(len(regions), 151))
    found, true = fitted(rows, regions, rng)
    assert (found > 0.9 * true).all() and (found < 2.0 * true).all()
