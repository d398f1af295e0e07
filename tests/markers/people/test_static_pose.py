"""A static pose: one frame of a static trial, whose observations count as many frames do."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxcap as jc
from jaxcap.errors import InputError
from jaxcap.markers.calibration.calibrate import Calibration
from jaxcap.markers.calibration.calibration_problem import CalibrationEstimate, make_calibration_problem
from jaxcap.markers.calibration.variances import marker_deviations
from jaxcap.markers.human import fit_human
from jaxcap.markers.human.describe_human import describe_frames
from jaxcap.markers.human.static_pose import append_static, standing_frame, static_weights, without_static
from jaxcap.markers.motion.inverse_kinematics import describe_lost
from jaxcap.markers.segments.swaps import CorrectedMarkers, describe_exchanges
from tests.markers_limb import moving, seen_by, truth


def test_a_frame_that_counts_three_times_is_three_frames(rng):
    """Value, gradient, equations of shared unknowns and deviations are those of a problem with the frame repeated.

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
        return (made.value(y), *made.normal_equations(y), marker_deviations(made, y))

    heavy = problem(np.array([0, 1, 2]), [3.0, 1.0, 1.0])
    repeated = problem(np.array([0, 0, 0, 1, 2]), [1.0] * 5)
    np.testing.assert_allclose(heavy[0], repeated[0], rtol=1e-9)
    np.testing.assert_allclose(heavy[1], repeated[1], rtol=1e-9)
    np.testing.assert_allclose(heavy[2][1], repeated[2][1], rtol=1e-8, atol=1e-8)
    np.testing.assert_allclose(heavy[3].shared, repeated[3].shared, rtol=1e-8, atol=1e-8)
    # the ridge of poses counts once too
    np.testing.assert_allclose(heavy[4], repeated[4], rtol=1e-4)


def test_a_static_trial_is_the_median_of_its_frames(rng):
    places = rng.uniform(0, 1.8, (3, 3)) + 1e-3 * rng.normal(size=(50, 3, 3))
    places[7, 0] += 1.0
    places[:20, 1] = np.nan
    static = jc.make_markers(places, ["LKNM", "LKNE", "LANK"], 100.0)
    one = standing_frame(static)
    assert len(one) == 1 and np.asarray(one.visible).all()
    np.testing.assert_allclose(one.positions[0], np.nanmedian(places, 0), atol=1e-9)
    take = jc.make_markers(rng.uniform(0, 1.8, (4, 2, 3)), ["LKNE", "LANK"], 50.0)
    both = append_static(take, static)
    assert len(both) == 5 and both.rate == 50.0
    np.testing.assert_array_equal(np.asarray(both.visible)[:, both.labels.index("LKNM")], [0, 0, 0, 0, 1])
    np.testing.assert_array_equal(both.positions[:4, :2], take.positions)
    with pytest.raises(InputError, match="stands still"):
        standing_frame(jc.make_markers(places + np.linspace(0, 1, 50)[:, None, None], static.labels, 100.0))


def test_frames_keep_their_numbers_next_to_a_static_pose(rng):
    """The frame of the static pose is the last one, and is in no number, index or sentence of the result."""
    lost = np.array([False, False, True, False, True])
    sliding, motion = "Skin slides.", moving(rng, 5)
    known = dict.fromkeys(Calibration._fields)
    distances = 5e-4 * np.arange(90.0).reshape(5, 18)
    # a bone is far off in the static pose and in three frames; one of these is lost
    distances[[0, 1, 2, 4], 15:] = 0.3
    known |= dict(subject=truth(), motion=motion, residuals=distances, lost=lost, frame_indices=np.array([0, 3, 4]))  # fmt: skip
    lost_only = Calibration(**known)
    assert describe_frames(lost_only) == describe_lost(lost)
    far = Calibration(**known | {"lost": np.zeros(5, bool)})
    assert "right_hand in 4 frames (0 to 4)" in describe_frames(far)[0]
    assert (
        "right_hand in 3 frames (0 to 2)"
        in without_static(far._replace(motion_messages=())).motion_messages[0]
    )
    rest = without_static(Calibration(**known | {"motion_messages": (sliding, *describe_lost(lost))}))
    np.testing.assert_array_equal(rest.frame_indices, [0, 3])
    np.testing.assert_array_equal(rest.residuals, distances[:4])
    np.testing.assert_array_equal(rest.motion.poses.rotations, motion.poses.rotations[:4])
    assert rest.motion_messages[0] == sliding and len(rest.motion_messages) == 3
    assert "1 of 4 frames" in rest.motion_messages[1] and "pose: 2." in rest.motion_messages[1]
    assert "static trial" in rest.motion_messages[2]


def test_labels_exchanged_in_the_static_trial_are_no_frame_of_a_take(rng, monkeypatch):
    places, seen = rng.uniform(-0.3, 0.3, (31, 6, 3)), np.ones((31, 6), bool)
    source = np.tile(np.arange(6), (31, 1))
    source[12, :2], source[-1, 2:4] = [1, 0], [3, 2]
    labels = tuple("abcdef")
    mended = CorrectedMarkers(places, seen, (), source, describe_exchanges(source, seen, labels))
    monkeypatch.setattr(fit_human, "correct_swaps", lambda *given: mended)
    said = fit_human.correct_labels(jc.make_markers(places, labels, 100.0), has_static=True)[1]
    assert len(said) == 2 and "in 1 frame (12)" in said[0], said
    assert "static trial" in said[1] and "c, d" in said[1] and "30" not in said[1]


def test_a_static_pose_counts_as_much_as_the_chosen_frames():
    np.testing.assert_array_equal(static_weights(4, 100), [1, 1, 1, 3])
    assert static_weights(1001, 400)[-1] == 400
    frames = jc.make_markers(np.zeros((4, 18, 3)), truth().labels, 100.0)
    with pytest.raises(ValueError, match="3 numbers for 4 frames"):
        jc.markers.calibrate(frames, truth(), frame_weights=np.ones(3))
