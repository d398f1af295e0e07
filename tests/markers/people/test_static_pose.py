"""A static pose: one frame of a static trial, whose observations count as many frames do."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxcap as jc
from jaxcap.errors import InputError
from jaxcap.markers.calibration.calibration_problem import CalibrationEstimate, make_calibration_problem
from jaxcap.markers.human.static_pose import prepend_static, standing_frame
from tests.markers_limb import moving, seen_by, truth


def test_a_frame_that_counts_three_times_is_three_frames(rng):
    """Value, gradient and equations of shared unknowns are those of a problem with the frame repeated.

    Priors of poses count once, so they are free here.
    """
    subject, motion = truth(), moving(rng, 3)
    frames = seen_by(subject, motion, rng, noise=5e-3)
    joints = (1, 2)

    def problem(rows, weights):
        made = make_calibration_problem(
            subject, frames.positions[rows], frames.visible[rows], joints, robust=False
        )
        made = eqx.tree_at(lambda p: p.frame_weights, made, jnp.asarray(weights))
        poses = jax.tree.map(lambda leaf: leaf[rows], motion.poses)
        shared = 0.002 * jnp.asarray(np.random.default_rng(1).normal(size=len(made.prior)))
        y = CalibrationEstimate(poses, shared, jnp.zeros((0, subject.num_markers, 3)))
        return (made.value(y), *made.normal_equations(y))

    heavy = problem(np.array([0, 1, 2]), [3.0, 1.0, 1.0])
    repeated = problem(np.array([0, 0, 0, 1, 2]), [1.0] * 5)
    np.testing.assert_allclose(heavy[0], repeated[0], rtol=1e-9)
    np.testing.assert_allclose(heavy[1], repeated[1], rtol=1e-9)
    np.testing.assert_allclose(heavy[2][1], repeated[2][1], rtol=1e-8, atol=1e-8)
    np.testing.assert_allclose(heavy[3].shared, repeated[3].shared, rtol=1e-8, atol=1e-8)


def test_a_static_trial_is_the_median_of_its_frames(rng):
    places = rng.uniform(0, 1.8, (3, 3)) + 1e-3 * rng.normal(size=(50, 3, 3))
    places[7, 0] += 1.0
    places[:20, 1] = np.nan
    static = jc.make_markers(places, ["LKNM", "LKNE", "LANK"], 100.0)
    one = standing_frame(static)
    assert len(one) == 1 and np.asarray(one.visible).all()
    np.testing.assert_allclose(one.positions[0], np.nanmedian(places, 0), atol=1e-9)
    take = jc.make_markers(rng.uniform(0, 1.8, (4, 2, 3)), ["LKNE", "LANK"], 50.0)
    both = prepend_static(static, take)
    assert len(both) == 5 and both.rate == 50.0
    np.testing.assert_array_equal(np.asarray(both.visible)[:, both.labels.index("LKNM")], [1, 0, 0, 0, 0])
    with pytest.raises(InputError, match="stands still"):
        standing_frame(jc.make_markers(places + np.linspace(0, 1, 50)[:, None, None], static.labels, 100.0))
