"""Centres and axes of rotation against what is known of them."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from jaxcap.markers.rotation_centres.axis_sara import find_hinge
from jaxcap.markers.rotation_centres.centre_precision import arc_bound, swept_arc
from jaxcap.markers.rotation_centres.estimate_joint import CENTRE_METHODS, find_joint
from jaxcap.markers.rotation_centres.gamage import concentric_centre
from jaxcap.markers.rotation_centres.sphere import density_weights, fit_circle, fit_sphere
from jaxcap.markers.segments.relative_motion import relative_motion
from jaxcap.markers.segments.segment_frames import fit_segment_frames
from jaxcap.markers.segments.segment_sets import make_segments
from tests.markers_scene import puppet

PAIR = ((-1, (0.0, 0.0, 0.0), (0.0, 0.0, 0.25)), (0, (0.0, 0.0, 0.0), (0.05, 0.0, -0.25)))


def between(rng, **how):
    scene = puppet(rng, bodies=PAIR, **how)
    segments = make_segments([np.flatnonzero(scene.owner == k) for k in (0, 1)], len(scene.owner))
    seen = np.ones(scene.places.shape[:2], bool)
    frames = fit_segment_frames(scene.places, seen, segments)
    # where the true centre is in the parent's frame as fitted
    back = np.einsum("fba,fb->fa", frames.rotations[:, 0], scene.joints[:, 1] - frames.origins[:, 0])
    motion = relative_motion(scene.places, seen, segments, frames, 0, 1)
    assert motion is not None
    return motion, back.mean(0), scene, frames


@pytest.mark.parametrize("method", sorted(CENTRE_METHODS))
def test_centres_are_exact_without_noise(rng, method):
    motion, centre, scene, frames = between(rng, frames=80)
    joint = find_joint(motion, 0, 1, method)
    np.testing.assert_allclose(joint.in_parent, centre, atol=1e-7)
    world = frames.rotations[:, 1] @ joint.in_child + frames.origins[:, 1]
    np.testing.assert_allclose(world, scene.joints[:, 1], atol=1e-7)
    assert joint.residual < 1e-7
    assert joint.axis_in_parent is None


@pytest.mark.parametrize("method", sorted(CENTRE_METHODS))
def test_a_hinge_has_rank_five_and_an_exact_axis(rng, method):
    axis = np.array([2.0, 1.0, -0.5]) / np.linalg.norm([2.0, 1.0, -0.5])
    motion, centre, scene, frames = between(rng, frames=80, hinges={1: tuple(axis)})
    hinge = find_hinge(motion.rotations)
    assert hinge.singular_values[0] < 1e-7 < 1e-2 < hinge.singular_values[1]
    world = frames.rotations[:, 0] @ hinge.in_parent
    cosines = np.einsum("fa,fab,b->f", world, scene.rotations[:, 0], axis)
    np.testing.assert_allclose(np.abs(cosines), 1.0, atol=1e-10)
    joint = find_joint(motion, 0, 1, method)
    off = joint.in_parent - centre
    np.testing.assert_allclose(off - (off @ hinge.in_parent) * hinge.in_parent, 0, atol=1e-6)
    # where along the axis is not told, and says so
    assert joint.deviations[2] > 0.1 > 1e-3 > joint.deviations[1]
    assert abs(joint.directions[2] @ hinge.in_parent) == pytest.approx(1, abs=1e-6)


def test_errors_fall_with_the_root_of_the_number_of_frames():
    means = []
    for frames in (60, 960):
        errors = []
        for seed in range(12):
            motion, centre, *_ = between(np.random.default_rng(seed), frames=frames, noise=0.003)
            errors.append(np.sum((find_joint(motion, 0, 1, "score").in_parent - centre) ** 2))
        means.append(np.sqrt(np.mean(errors)))
    # sixteen times the frames: a fourth, give or take; 600 of them are used
    assert 2.0 < means[0] / means[1] < 8.0


def test_precision_covers_the_error():
    inside = []
    for seed in range(20):
        motion, centre, *_ = between(np.random.default_rng(seed), frames=200, noise=0.003)
        joint = find_joint(motion, 0, 1, "score")
        inside.append(np.abs(joint.directions @ (joint.in_parent - centre)) < 1.645 * joint.deviations)
    assert 0.75 < np.mean(inside) <= 1.0


def test_the_algebraic_sphere_is_biased_and_the_corrected_and_geometric_ones_are_not():
    centre = np.array([0.1, -0.2, 0.05])
    algebraic, corrected, geometric = [], [], []
    for seed in range(30):
        rng = np.random.default_rng(seed)
        away = Rotation.from_rotvec(0.35 * rng.normal(size=(400, 3))).apply([0.0, 0.0, 0.3])
        track = centre + away + 0.01 * rng.normal(size=(400, 3))
        seen = np.ones((400, 1), bool)
        for some, unbiased in ((algebraic, False), (corrected, True)):
            found, _ = concentric_centre(track[:, None], seen, np.ones(1), centre, 10.0, False, unbiased)
            some.append((found - centre)[2])
        geometric.append((fit_sphere(track, np.ones(400), centre, 10.0, False).centre - centre)[2])
    # the bias is towards the data
    assert np.mean(algebraic) > 0.02
    assert abs(np.mean(corrected)) < 0.005
    assert abs(np.mean(geometric)) < 0.005


def test_circle_of_a_flat_trajectory():
    angles = np.linspace(0, 1.2, 90)
    flat = np.stack([0.3 * np.cos(angles), 0.3 * np.sin(angles), np.zeros(90)], 1)
    turn = Rotation.from_rotvec([0.4, 1.0, -0.3]).as_matrix()
    centre = np.array([0.2, 0.1, -0.4])
    ball = fit_circle(flat @ turn.T + centre, np.ones(90), 0.3)
    np.testing.assert_allclose(ball.centre, centre, atol=1e-8)
    assert ball.radius == pytest.approx(0.3, abs=1e-8)
    assert ball.normal is not None
    assert abs(ball.normal @ turn[:, 2]) == pytest.approx(1, abs=1e-10)
    # nothing is known along the axis
    assert abs(turn[:, 2] @ ball.information @ turn[:, 2]) < 1e-6 * np.trace(ball.information)


def test_rare_places_weigh_as_much_as_common_ones(rng):
    ends = np.array([[0.0, 0, 0], [1.0, 0, 0]])
    track = np.concatenate([ends[0] + 1e-3 * rng.random((90, 3)), ends[1] + 1e-3 * rng.random((10, 3))])
    weights = density_weights(track)
    assert weights[:90].sum() == pytest.approx(weights[90:].sum(), rel=1e-9)


def test_the_bound_is_that_of_the_arc():
    # a centre wrong by e towards the middle of an arc changes distances by e (1 - cos(half the arc))
    half, wrong = 0.4, 1e-4
    angles = np.linspace(-half, half, 400)
    arc = 0.3 * np.stack([np.cos(angles), np.sin(angles), 0 * angles], 1)
    assert swept_arc(arc, np.zeros(3)) == pytest.approx(2 * half, rel=0.03)
    distances = np.linalg.norm(arc - np.array([wrong, 0, 0]), axis=1)
    assert np.ptp(distances) == pytest.approx(wrong * (1 - np.cos(half)), rel=1e-2)
    assert arc_bound(distances, 2 * half) == pytest.approx(0.5 * wrong, rel=0.15)


def test_a_joint_that_does_not_turn_is_not_made_up(rng):
    motion, *_ = between(rng, frames=200, noise=0.002, still=(1,))
    for method in CENTRE_METHODS:
        joint = find_joint(motion, 0, 1, method)
        assert joint.deviations.min() > 0.1
        # it stays where it was thought to be
        assert np.linalg.norm(joint.in_parent - motion.prior_centre) < 0.02


def test_frames_by_axes_and_by_procrustes_agree_on_rigid_markers(rng):
    scene = puppet(rng, frames=30)
    segments = make_segments([np.flatnonzero(scene.owner == k) for k in range(6)], len(scene.owner))
    seen = np.ones(scene.places.shape[:2], bool)
    one, other = (
        fit_segment_frames(scene.places, seen, segments, method) for method in ("procrustes", "axes")
    )
    np.testing.assert_allclose(one.rotations, other.rotations, atol=1e-9)
    np.testing.assert_allclose(one.origins, other.origins, atol=1e-9)
    assert np.nanmax(one.residuals(scene.places, seen, segments)) < 1e-9
    # fewer than three markers leave the frame open
    seen[5, :2] = False
    known = fit_segment_frames(scene.places, seen, segments).known
    assert not known[5, 0] and known.sum() == known.size - 1
