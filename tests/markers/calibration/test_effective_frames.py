"""Correlation times of processes with known ones."""

import numpy as np
import pytest
from scipy.signal import lfilter

from jaxcap.markers.calibration.effective_frames import correlation_time


def test_independent_residuals_have_no_correlation_time(rng):
    residuals = rng.normal(size=(2000, 6, 3))
    assert correlation_time(residuals, np.ones((2000, 6), bool)) == pytest.approx(1.0, abs=0.2)


@pytest.mark.parametrize("share", [0.5, 0.9])
def test_an_autoregressive_process_has_its_known_time(rng, share):
    """A process of the first order has the time (1 + a) / (1 - a); gaps and other sizes of markers change nothing."""
    residuals = (
        lfilter([1.0], [1.0, -share], rng.normal(size=(20000, 4, 3)), axis=0)
        * np.array([1.0, 10.0, 0.1, 1.0])[:, None]
    )
    seen = rng.uniform(size=(20000, 4)) > 0.2
    assert correlation_time(residuals, seen) == pytest.approx((1 + share) / (1 - share), rel=0.12)
