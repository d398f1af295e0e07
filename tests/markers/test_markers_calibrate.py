"""Calibration: known subjects found again, known null directions told."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

from jaxcap.geometry import rotation
from jaxcap.markers.calibration.calibrate import calibrate
from jaxcap.markers.calibration.calibration_parameters import TemplatePrior, shift_subject, solved_joints
from jaxcap.markers.calibration.gauge_freedom import gauge_constraints, gauge_directions
from jaxcap.markers.calibration.observability import bone_length_deviations, centre_covariances
from jaxcap.markers.calibration.residuals import marker_residuals
from jaxcap.markers.calibration.solve_calibration import solve_calibration
from jaxcap.observe.markers import MarkerFrames
from tests.markers_limb import bone_lengths, moving, seen_by, truth, wrong

SUBJECT = truth()
JOINTS = (1, 2, 3, 4)


def test_what_no_marker_tells_changes_no_residual(rng):
    """As many directions as bones may turn and the whole may move; a shift of all is undone by the root."""
    gauge = gauge_directions(SUBJECT, JOINTS)
    assert gauge.shape == (3 * (4 + 18), 3 * 5 + 3)
    assert np.linalg.matrix_rank(gauge) == 18
    assert np.linalg.matrix_rank(gauge_constraints(SUBJECT, JOINTS) @ gauge) == 18
    # the last three move all of the body as one: the root's translation undoes them exactly
    places = np.asarray(seen_by(SUBJECT, moving(np.random.default_rng(1)), rng, 0.0).positions[3])
    pose = moving(np.random.default_rng(1))[3]
    shift = np.array([0.01, -0.02, 0.03])
    moved = shift_subject(SUBJECT, JOINTS, jnp.asarray(gauge[:, -3:] @ shift))
    root = np.asarray(pose.rotations[0])
    back = eqx.tree_at(
        lambda p: p.translations,
        pose,
        pose.translations.at[0].add(-rotation.rotate(jnp.asarray(root), jnp.asarray(shift))),
    )
    # the root's own centre stays, so its children and all markers have gone with the shift
    np.testing.assert_allclose(marker_residuals(moved, back, jnp.asarray(places)), 0, atol=1e-12)


def test_calibration_finds_the_subject(rng):
    motion = moving(rng, 60)
    frames = seen_by(SUBJECT, motion, rng)
    template = wrong(SUBJECT, rng)
    places, seen = np.array(frames.positions), np.array(frames.visible)
    for frame in range(0, 60, 3):
        a, b = rng.choice(18, 2, replace=False)
        places[frame, [a, b]] = places[frame, [b, a]]
    for _ in range(8):
        start, marker = rng.integers(50), rng.integers(18)
        seen[start : start + 10, marker] = False
    bad = MarkerFrames(places, seen, frames.labels, 100.0)
    found = calibrate(bad, template, symmetry=[("left_hand", "right_hand")])
    assert found.converged
    lengths = bone_lengths(found.subject)
    assert abs(lengths[0] - lengths[1]) < 1e-6
    np.testing.assert_allclose(lengths, 0.3, atol=2e-3)
    assert 0.7e-3 < float(np.median(found.subject.deviations)) < 1.4e-3
    assert np.nanmedian(found.residuals) < 2.5e-3
    assert solved_joints(SUBJECT, np.ones(18, bool)) == JOINTS == found.joints
    order = rng.permutation(18)
    mixed = MarkerFrames(places[:, order], seen[:, order], tuple(frames.labels[i] for i in order), 100.0)
    again = calibrate(mixed, template, symmetry=[("left_hand", "right_hand")])
    np.testing.assert_allclose(again.subject.offsets, found.subject.offsets, atol=1e-9)
    # its last fit can be continued to a minimum with derivatives
    solution = solve_calibration(found.problem, found.estimate)
    assert bool(solution.trustworthy)
    before = 2.0 * float(found.problem.value(found.estimate))
    assert 0.99 * before < float(solution.energy) <= before


def test_a_hinge_does_not_tell_where_along_its_axis_it_is(rng):
    motion = moving(rng, 60, hinge=2)
    found = calibrate(seen_by(SUBJECT, motion, rng), wrong(SUBJECT, rng))
    about = [line for line in found.messages if "left_hand" in line]
    assert len(about) == 1 and about[0].startswith("Along the axis of rotation")
    assert not any("right_hand" in line or "right_arm" in line for line in found.messages)
    values, vectors = np.linalg.eigh(centre_covariances(found.subject, found.joints, found.covariance)[1])
    assert np.sqrt(values[2]) > 5e-3 > 1.5e-3 > np.sqrt(values[1])
    assert abs(vectors[2, 2]) > 0.9


def test_joints_without_markers_are_told(rng):
    frames = seen_by(SUBJECT, moving(rng, 30), rng)
    seen = np.array(frames.visible)
    seen[:, SUBJECT.bones == 2] = False
    found = calibrate(MarkerFrames(frames.positions, seen, frames.labels, 100.0), SUBJECT)
    assert 2 not in found.joints
    assert any("No markers determine" in line and "left_hand" in line for line in found.messages)


def test_intervals_hold_what_they_say():
    inside = []
    for seed in range(24):
        rng = np.random.default_rng(seed)
        motion = moving(rng, 30)
        found = calibrate(seen_by(SUBJECT, motion, rng), wrong(SUBJECT, rng))
        deviations = bone_length_deviations(found.subject, found.joints, found.covariance)[[2, 4]]
        inside.append(np.abs(bone_lengths(found.subject) - 0.3) < 1.645 * deviations)
    # 48 lengths, 90 %: from 80 to 98 % with a chance of 95 %
    assert 0.8 <= np.mean(inside) <= 0.99


def test_what_cannot_be_calibrated_is_refused(rng):
    frames = seen_by(SUBJECT, moving(rng, 5), rng)
    seen = np.zeros_like(frames.visible)
    seen[:, :2] = True
    with pytest.raises(ValueError, match="Only 2 markers are ever visible"):
        calibrate(MarkerFrames(frames.positions, seen, frames.labels, 100.0), SUBJECT)
    with pytest.raises(ValueError, match="no joint 'tail'"):
        calibrate(frames, SUBJECT, symmetry=[("tail", "left_hand")])


def test_the_prior_holds_bones_and_not_places():
    """To lengthen a bone takes what hangs on it along, at no further cost."""
    precision = TemplatePrior().precision(SUBJECT, JOINTS)
    carried = np.zeros((22, 3))
    carried[[0, 1]] = carried[4 + np.flatnonzero(np.isin(SUBJECT.bones, [1, 2]))] = [0.02, 0, 0]
    alone = np.zeros((22, 3))
    alone[0] = [0.02, 0, 0]
    arm = 0.1 * np.linalg.norm(SUBJECT.skeleton.centres[1]) + 0.01
    assert carried.ravel() @ precision @ carried.ravel() == pytest.approx((0.02 / arm) ** 2)
    assert alone.ravel() @ precision @ alone.ravel() > (0.02 / arm) ** 2
