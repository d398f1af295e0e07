"""Clips cut, resampled, joined, looped and mirrored, against SciPy, brute force and motions that are known whole."""

import jax.numpy as jnp
import numpy as np
import pytest
from helpers import chain_skeleton
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation, Slerp

from jaxcap.body.kinematics import joint_paths
from jaxcap.body.pose import Motion, Pose
from jaxcap.body.skeleton import make_skeleton
from jaxcap.edit.clips import cut, join, make_loop
from jaxcap.edit.interpolation import resample
from jaxcap.edit.mirror_motion import mirror
from jaxcap.edit.planar_transform import (
    PlanarTransform,
    apply_planar_transform,
    fit_planar_transform,
    planar_power,
)
from jaxcap.edit.transitions import find_loops, find_transitions, transition_distances
from jaxcap.geometry import rotation

SKELETON = make_skeleton(
    ["hips", "chest", "LeftArm", "LeftHand", "RightArm", "RightHand"],
    [-1, 0, 1, 2, 1, 4],
    ["free"] + ["ball"] * 5,
    [[0, 1.0, 0], [0, 1.3, 0.02], [0.2, 1.4, 0], [0.6, 1.3, 0.1], [-0.2, 1.4, 0], [-0.6, 1.3, 0.1]],
)
PERIOD = 20


def gait(frames=70, turn=0.4, speed=0.05):
    """Goes on and turns; what joints do has a period of `PERIOD` frames."""
    t = np.arange(frames)
    phase = 2 * np.pi * t[:, None] / PERIOD
    vectors = np.stack(
        [0.4 * np.sin(phase * k + np.arange(3)) + 0.1 * np.cos(phase) for k in (1, 2, 1, 2, 1, 3)], 1
    )
    heading = Rotation.from_rotvec(np.outer(turn * t / PERIOD, [0, 1.0, 0]))
    vectors[:, 0] = (heading * Rotation.from_rotvec(0.2 * vectors[:, 0])).as_rotvec()
    step = heading.apply([0.3 * speed, 0, speed])
    places = np.cumsum(step, 0) + np.stack([0 * t, 0.03 * np.sin(2 * phase[:, 0]), 0 * t], 1)
    translations = np.zeros((frames, 6, 3))
    translations[:, 0] = places
    return Motion(Pose(jnp.asarray(translations), rotation.exp(jnp.asarray(vectors)), jnp.ones(frames)), 30.0)


def places(motion, skeleton=SKELETON):
    return np.asarray(joint_paths(skeleton, motion.poses))


def test_cut_keeps_the_frames_that_are_named():
    motion = gait(10)
    np.testing.assert_array_equal(cut(motion, 2, 5).poses.rotations, motion.poses.rotations[2:6])
    assert len(cut(motion, -3)) == 3
    for arguments, words in (
        ((3, 2), "comes before"),
        ((0, 10), "The last frame is 10"),
        ((-11,), "first frame"),
    ):
        with pytest.raises(ValueError, match=words):
            cut(motion, *arguments)


def test_resampled_rotations_are_those_of_scipy():
    motion = gait(31)
    found = resample(motion, 47.0)
    times = np.arange(len(found)) / 47.0
    assert len(found) == int(30 / 30.0 * 47) + 1
    for joint in range(6):
        turns = Rotation.from_quat(np.asarray(motion.poses.rotations[:, joint]), scalar_first=True)
        want = Slerp(np.arange(31) / 30.0, turns)(times)
        here = Rotation.from_quat(np.asarray(found.poses.rotations[:, joint]), scalar_first=True)
        np.testing.assert_allclose((want.inv() * here).magnitude(), 0.0, atol=1e-12)
    np.testing.assert_array_equal(resample(motion, 30).poses.rotations, motion.poses.rotations)
    np.testing.assert_array_equal(resample(motion, 10).poses.rotations, motion.poses.rotations[::3])
    with pytest.raises(ValueError, match="above 0"):
        resample(motion, 0)


def test_a_planar_motion_is_found_again_and_halved(rng):
    points = rng.normal(size=(20, 3))
    for planar in (PlanarTransform(2.5, np.array([0.3, -1.2])), PlanarTransform(0.0, np.array([1.0, 2.0]))):
        motion = gait(2)
        moved = places(Motion(apply_planar_transform(SKELETON, planar, motion.poses), 30.0))
        found = fit_planar_transform(places(motion)[0], moved[0])
        np.testing.assert_allclose(found.heading, planar.heading, atol=1e-12)
        np.testing.assert_allclose(found.shift, planar.shift, atol=1e-12)
        half = planar_power(planar, 0.5)
        twice = Motion(
            apply_planar_transform(SKELETON, half, apply_planar_transform(SKELETON, half, motion.poses)), 30.0
        )
        np.testing.assert_allclose(places(twice), moved, atol=1e-12)
    assert fit_planar_transform(points, points).heading == pytest.approx(0.0, abs=1e-12)


def test_distances_of_windows_are_the_least_over_turns_and_shifts():
    a, b = gait(12), gait(9, turn=-0.3, speed=0.02)
    found = transition_distances(SKELETON, a, b, 4)
    assert found.shape == (9, 6)
    x, y = places(a).copy(), places(b).copy()
    for i, j in ((0, 0), (3, 5), (8, 2)):
        here, there = y[j : j + 4].reshape(-1, 3), x[i : i + 4].reshape(-1, 3)

        def cost(p, here=here, there=there):
            turned = Rotation.from_rotvec([0, p[0], 0]).apply(here) + [p[1], 0, p[2]]
            return np.mean(np.sum((turned - there) ** 2, 1))

        best = min(minimize(cost, [angle, 0, 0], tol=1e-12).fun for angle in (-2.0, 0.0, 2.0))
        assert found[i, j] ** 2 == pytest.approx(best, rel=1e-5)
    with pytest.raises(ValueError, match="window of 10 frames"):
        transition_distances(SKELETON, a, b, 10)


def test_a_motion_taken_apart_is_joined_to_itself():
    """Two overlapping parts of one motion, the second one moved elsewhere, give the whole again."""
    whole = gait(60)
    rest = apply_planar_transform(SKELETON, PlanarTransform(1.9, np.array([3.0, -2.0])), cut(whole, 25).poses)
    joined = join(SKELETON, cut(whole, 0, 34), Motion(rest, 30.0), 10)
    assert len(joined) == 60
    np.testing.assert_allclose(places(joined), places(whole), atol=1e-9)
    np.testing.assert_allclose(
        rotation.distance(joined.poses.rotations, whole.poses.rotations), 0.0, atol=1e-7
    )
    best = find_transitions(SKELETON, cut(whole, 0, 34), Motion(rest, 30.0), 10)[0]
    # what is alike is also a period apart
    assert best.distance < 1e-6 and (best.first - 25 - best.second) % PERIOD == 0


def test_joined_without_a_blend_a_straight_walk_goes_on():
    whole = gait(40, turn=0.0)
    still = Pose(whole.poses.translations, whole.poses.rotations[:1].repeat(40, 0), whole.poses.scale)
    straight = np.zeros((40, 6, 3))
    straight[:, 0] = np.outer(np.arange(40), [0.02, 0.0, 0.05])
    motion = Motion(Pose(jnp.asarray(straight), still.rotations, still.scale), 30.0)
    joined = join(SKELETON, cut(motion, 0, 19), cut(motion, 5, 24), 0)
    np.testing.assert_allclose(places(joined), places(motion), atol=1e-9)


def test_a_blend_is_smooth_where_motions_differ():
    a, b = gait(40), gait(40, turn=-0.5, speed=0.02)
    joined = places(join(SKELETON, a, cut(b, 3), 12))
    jumps = np.linalg.norm(np.diff(joined, 2, axis=0), axis=-1).max()
    own = max(np.linalg.norm(np.diff(places(m), 2, axis=0), axis=-1).max() for m in (a, b))
    assert jumps < 2 * own
    with pytest.raises(ValueError, match="does not fit"):
        join(SKELETON, a, b, 41)
    with pytest.raises(ValueError, match="resample"):
        join(SKELETON, a, Motion(b.poses, 60.0), 3)
    with pytest.raises(ValueError, match="has 6 joints; expected 9"):
        join(chain_skeleton(), a, b, 3)


@pytest.mark.parametrize("in_place", [False, True])
def test_a_loop_goes_over_its_seam_as_the_motion_does(in_place, rng):
    motion = gait(70)
    noise = rotation.exp(jnp.asarray(0.05 * rng.normal(size=(70, 6, 3))))
    motion = Motion(
        Pose(motion.poses.translations, rotation.multiply(motion.poses.rotations, noise), motion.poses.scale),
        30.0,
    )
    first, last, blend = 12, 50, 8
    loop = make_loop(SKELETON, motion, first, last, blend, in_place)
    assert len(loop.motion) == last - first + 1
    x, own = places(loop.motion), places(motion)
    # the next round is the same in the place where this one ended
    again = places(Motion(apply_planar_transform(SKELETON, loop.travel, loop.motion.poses), 30.0))
    np.testing.assert_allclose(again[0], x[-1], atol=1e-9)
    if in_place:
        np.testing.assert_array_equal(x[0], x[-1])
        assert np.abs(x[:, 0, [0, 2]] - x[0, 0, [0, 2]]).max() < np.ptp(own[first:last, 0, [0, 2]], 0).max()
        return
    # before, at and after the seam three frames of the motion itself, so velocities agree as well
    seam = np.stack([x[-2], x[-1], again[1]])
    three = own[first - 1 : first + 2]
    back = apply_planar_transform(SKELETON, loop.travel, cut(motion, first - 1, first + 1).poses)
    np.testing.assert_allclose(seam, places(Motion(back, 30.0)), atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(np.diff(seam, axis=0), axis=-1),
                               np.linalg.norm(np.diff(three, axis=0), axis=-1), atol=1e-9)  # fmt: skip


def test_loops_are_found_at_the_period():
    motion = gait(70)
    found = find_loops(SKELETON, motion, 5, 15, 60, count=2)
    assert all((f.second - f.first) % PERIOD == 0 for f in found)
    assert found[0].distance < 1e-6
    assert abs(found[0].first - found[1].first) > 5 or abs(found[0].second - found[1].second) > 5
    with pytest.raises(ValueError, match="does not fit"):
        find_loops(SKELETON, motion, 5, 66)
    for arguments, words in (
        ((3, 40, 8), "takes the 8 frames before"),
        ((12, 80, 8), "not in a motion"),
        ((12, 16, 8), "does not fit a loop"),
    ):
        with pytest.raises(ValueError, match=words):
            make_loop(SKELETON, motion, *arguments)


def test_a_mirror_swaps_sides_and_twice_is_none():
    motion = gait(8)
    mirrored = mirror(SKELETON, motion)
    want = places(motion)[:, [0, 1, 4, 5, 2, 3]] * [-1, 1, 1]
    np.testing.assert_allclose(places(mirrored), want, atol=1e-12)
    twice = mirror(SKELETON, mirrored)
    np.testing.assert_allclose(twice.poses.rotations, motion.poses.rotations, atol=0)
    with pytest.raises(ValueError, match="No joint has a counterpart"):
        mirror(
            chain_skeleton(), Motion(Pose(jnp.zeros((2, 9, 3)), jnp.ones((2, 9, 4)) / 2, jnp.ones(2)), 30.0)
        )
