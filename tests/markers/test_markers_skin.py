"""Skin that slides with the joints: found where it is, not where it is not, and told from other centres."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import jaxcap as jc
from jaxcap.markers.calibration.calibrate import calibrate, with_unsure_sliding
from jaxcap.markers.calibration.calibration_problem import CalibrationEstimate, make_calibration_problem
from jaxcap.markers.calibration.rotation_prior import rotation_vectors_from_mean
from jaxcap.markers.calibration.soft_tissue import (
    align_features,
    further_features,
    initial_slide_deviation,
    refit_slides,
    skin_features,
    skin_shifts,
)
from jaxcap.observe.markers import MarkerFrames
from tests.markers_limb import bone_lengths, moving, seen_by, truth, wrong

SUBJECT = truth()


def slid(motion, rng, size):
    """Markers that slide with their bone's joints, and by how much, metres."""
    features = skin_features(SUBJECT, motion.poses)
    slides = size * rng.normal(size=(features.shape[2], SUBJECT.num_markers, 3))
    frames = seen_by(SUBJECT, motion, rng)
    shifts = skin_shifts(features, slides)
    turns = jax.vmap(lambda pose: jc.forward_kinematics(SUBJECT.skeleton, pose).rotations)(motion.poses)
    seen = np.einsum("fmab,fmb->fma", np.asarray(turns)[:, np.asarray(SUBJECT.bones)], shifts)
    return MarkerFrames(frames.positions + seen, frames.visible, frames.labels, frames.rate), shifts


def test_turns_of_both_ends_of_a_bone_are_features(rng):
    motion = moving(rng, 50)
    features = skin_features(SUBJECT, motion.poses)
    bones = np.asarray(SUBJECT.bones)
    assert features.shape[:2] == (50, 18)
    np.testing.assert_allclose(features.mean(0), 0, atol=1e-12)
    # markers of one bone have the same, those of others have others
    np.testing.assert_array_equal(features[:, bones == 1], np.repeat(features[:, 4:5], 4, 1))
    assert not np.allclose(features[:, 0], features[:, 4])
    # a hand's joint alone moves its skin, by three numbers and its angle
    assert np.linalg.matrix_rank(features[:, bones == 2][:, 0], tol=1e-6) <= 4


def test_skin_is_found_where_residuals_follow_the_joints(rng):
    motion = moving(rng, 60)
    features = skin_features(SUBJECT, motion.poses)
    noise = 1e-3 * rng.normal(size=(60, 18, 3))
    seen = np.ones((60, 18), bool)
    assert initial_slide_deviation(features, noise, seen) is None
    slides = 0.01 * rng.normal(size=(features.shape[2], 18, 3))
    found = initial_slide_deviation(features, noise + skin_shifts(features, slides), seen)
    assert found is not None and 0.005 < found < 0.02
    assert initial_slide_deviation(features, noise, np.zeros_like(seen)) is None


def test_renewed_features_shift_markers_as_before(rng):
    features = skin_features(SUBJECT, moving(rng, 60).poses)
    slides = 0.01 * rng.normal(size=(features.shape[2], 18, 3))
    mixing = rng.normal(size=(features.shape[2],) * 2)
    renewed = refit_slides(features, slides, features @ mixing)
    np.testing.assert_allclose(
        skin_shifts(features @ mixing, renewed), skin_shifts(features, slides), atol=1e-9
    )


def test_renewed_features_are_aligned_with_the_old_ones(rng):
    features = skin_features(SUBJECT, moving(rng, 60).poses)
    # directions with nearly equal sizes come in any order and with any sign
    mixed = features[..., [1, 0, 3, 2]] * [-1.0, 1.0, 1.0, -1.0]
    np.testing.assert_allclose(align_features(features, mixed), features, atol=1e-9)


def test_further_features_contain_products_of_rotations(rng):
    poses = moving(rng, 60).poses
    features = skin_features(SUBJECT, poses)
    further = further_features(SUBJECT, poses, features)
    np.testing.assert_allclose(np.einsum("fmk,fme->mke", features, further), 0, atol=1e-9)
    turns = rotation_vectors_from_mean(np.asarray(poses.rotations))[:, 2]
    wide = np.column_stack([np.ones(60), features[:, 8], further[:, 8]])
    left = turns[:, 0] * turns[:, 1] - wide @ np.linalg.lstsq(wide, turns[:, 0] * turns[:, 1], rcond=None)[0]
    assert np.abs(left).max() < 1e-9


def test_covariances_know_that_slides_are_unsure(rng):
    """A bone with small slides counts as one of usual slides, in further directions, too; skin that does not slide stays so."""
    motion = moving(rng, 20)
    frames = seen_by(SUBJECT, motion, rng)
    problem = make_calibration_problem(
        SUBJECT, jnp.asarray(frames.positions), jnp.asarray(frames.visible), (1, 2, 3, 4)
    )
    rigid = CalibrationEstimate(motion.poses, jnp.zeros(len(problem.prior)), jnp.zeros((0, 18, 3)))
    assert with_unsure_sliding(problem, rigid) == (problem, rigid)
    features = jnp.asarray(skin_features(SUBJECT, motion.poses))
    deviations = jnp.where(SUBJECT.bones == 2, 0.02, 0.001)[None].repeat(features.shape[2], 0)
    slid = eqx.tree_at(lambda p: (p.skin_features, p.slide_deviations), problem, (features, deviations))
    estimate = CalibrationEstimate(motion.poses, rigid.shared, jnp.zeros((features.shape[2], 18, 3)))
    unsure, at = with_unsure_sliding(slid, estimate)
    assert at.slides.shape == (12, 18, 3) and unsure.skin_features.shape == (20, 18, 12)
    usual = np.sqrt(np.mean(np.asarray(deviations) ** 2))
    expected = np.where(np.asarray(SUBJECT.bones) == 2, 0.02, usual)
    np.testing.assert_allclose(unsure.slide_deviations, np.tile(expected, (12, 1)))
    before, after = (np.diag(each.shared_covariance(y)) for each, y in ((slid, estimate), (unsure, at)))
    count = len(problem.prior)
    assert np.all(after[:count] > before[:count] - 1e-12)


def test_slides_are_not_taken_for_longer_bones():
    """Much of what slides would do to bones is taken off it."""
    off, without = [], []
    for seed in range(8):
        rng = np.random.default_rng(seed)
        frames, shifts = slid(moving(rng, 60), rng, 0.006)
        template = wrong(SUBJECT, rng)
        found = calibrate(frames, template)
        true = np.sqrt(np.mean(np.sum(shifts**2, -1)))
        assert 0.6 * true < np.sqrt(np.mean(found.slides**2)) < 1.4 * true
        off.append(np.abs(bone_lengths(found.subject) - 0.3))
        plain = calibrate(frames, template, skin=False)
        assert not plain.slides.any()
        without.append(np.abs(bone_lengths(plain.subject) - 0.3))
    assert np.mean(off) < 0.7 * np.mean(without)


def test_noise_alone_slides_nothing(rng):
    found = calibrate(seen_by(SUBJECT, moving(rng, 60), rng), wrong(SUBJECT, rng))
    assert not found.slides.any()
