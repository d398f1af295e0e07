"""Gaps filled by pose, neighbours and time: the statistics against Gaussian conditioning, and coverage on made gaps."""

import numpy as np

import jaxcap as jc
from jaxcap.markers.motion.gap_filling import predicted_positions
from jaxcap.markers.motion.gap_model import Gap, bridge
from tests.markers_limb import moving, seen_by, truth

SUBJECT = truth()


def test_a_bridge_is_the_conditioned_process():
    """The closed form against a matrix of covariances that is conditioned on both ends, or on one."""
    time = 7.0
    for before, after in ((9, 25), (-1, 25), (9, -1)):
        gap = Gap(0, 10, 25, before, after)
        ends = np.array([end for end in (before, after) if end >= 0])
        at = np.arange(10, 25)
        cross = np.exp(-np.abs(at[:, None] - ends) / time)
        gain = cross @ np.linalg.inv(np.exp(-np.abs(ends[:, None] - ends) / time))
        left, right, variance = bridge(gap, time)
        both = np.stack([part for part, end in ((left, before), (right, after)) if end >= 0], 1)
        np.testing.assert_allclose(both, gain, atol=1e-12)
        np.testing.assert_allclose(variance, 1 - (gain * cross).sum(1), atol=1e-12)


def test_sliding_markers_are_filled_better_than_by_their_bone_and_the_interval_holds(rng):
    """Two markers of each bone slide together, slowly: the neighbour predicts most of the sliding in a gap."""
    motion = moving(rng, 400)
    frames = seen_by(SUBJECT, motion, rng, noise=5e-4)
    places, bones = np.array(frames.positions), np.asarray(SUBJECT.bones)
    steps = rng.normal(size=(400, 5, 3))
    slide = np.zeros_like(steps)
    for frame in range(1, 400):
        slide[frame] = 0.97 * slide[frame - 1] + 0.24 * steps[frame]
    places += 0.008 * slide[:, bones] * (np.arange(18) % 2)[:, None]
    seen = np.ones(places.shape[:2], bool)
    for marker in (1, 5, 13):
        for begin in (40, 150, 260):
            seen[begin : begin + 30, marker] = False
    cut = jc.MarkerFrames(np.where(seen[..., None], places, 0), seen, SUBJECT.labels, 100.0)
    solved = jc.markers.solve_markers(SUBJECT, cut)
    found = jc.markers.estimate_gaps(SUBJECT, solved.motion, cut)
    assert np.asarray(found.frames.visible).all()
    np.testing.assert_array_equal(np.asarray(found.frames.positions)[seen], places[seen])
    off = np.linalg.norm(np.asarray(found.frames.positions) - places, axis=2)[~seen]
    assert (found.deviations[seen] == 0).all() and (found.deviations[~seen] > 0).all()
    by_bone = np.linalg.norm(np.asarray(predicted_positions(SUBJECT, solved.motion)) - places, axis=2)[~seen]
    assert np.sqrt(np.mean(off**2)) < 0.85 * np.sqrt(np.mean(by_bone**2))
    # three axes with at most this deviation along each
    inside = off < 2.5 * found.deviations[~seen]
    assert inside.mean() > 0.85
    assert np.median(found.deviations[~seen]) < 0.02
