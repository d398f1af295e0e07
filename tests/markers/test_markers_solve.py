"""Solving for the motion of a known subject, at once and frame by frame."""

import copy
import pickle

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxcap.body.kinematics import forward_kinematics, joint_positions
from jaxcap.body.pose import Motion
from jaxcap.body.retraction import retract
from jaxcap.errors import InputError
from jaxcap.io.markers.subject import load_subject, save_subject
from jaxcap.markers.motion.doubtful_solutions import FAR, MIN_FAR_FRAMES
from jaxcap.markers.motion.inverse_kinematics import (
    INITIAL_SEARCH,
    LABELLED_SEARCH,
    marker_residuals_of_frames,
    solve_doubtful_frames,
    solve_each_frame,
    solve_markers,
)
from jaxcap.markers.motion.solve_frame import SearchCriteria, SolvedFrame
from jaxcap.markers.motion.stream import make_streamer, stream_frame
from jaxcap.markers.motion.unexplained_bones import unexplained_bones
from jaxcap.markers.subject import shift_markers
from jaxcap.observe.markers import MarkerFrames
from jaxcap.stacking import stack_trees
from tests.markers_limb import moving, seen_by, truth

SUBJECT = truth()
_joints = jax.jit(
    jax.vmap(lambda pose: joint_positions(SUBJECT.skeleton, forward_kinematics(SUBJECT.skeleton, pose)))
)


def errors(motion, truly) -> np.ndarray:
    return np.linalg.norm(np.asarray(_joints(motion.poses) - _joints(truly.poses)), axis=2)


def test_exact_markers_give_the_exact_motion(rng):
    motion = moving(rng)
    frames = seen_by(SUBJECT, motion, rng, noise=0.0)
    solved = solve_markers(SUBJECT, frames)
    assert errors(solved.motion, motion).max() < 1e-6
    assert not solved.lost.any() and not solved.messages
    assert solved.motion.rate == frames.rate


def test_gaps_and_swapped_labels(rng):
    """A marker that is not seen is as one that is not there, whatever stands in its place; swapped
    labels are left out; a frame without markers is told and harms no other."""
    motion = moving(rng)
    frames = seen_by(SUBJECT, motion, rng)
    places, seen = np.array(frames.positions), np.array(frames.visible)
    places[7, [0, 9]] = places[7, [9, 0]]
    seen[12:18, 5] = False
    seen[25] = False
    zero = solve_markers(
        SUBJECT, MarkerFrames(np.where(seen[..., None], places, 0), seen, SUBJECT.labels, 100.0)
    )
    blank = np.where(seen[..., None], places, np.nan)
    nan = solve_markers(SUBJECT, MarkerFrames(blank, np.ones_like(seen), SUBJECT.labels, 100.0))
    np.testing.assert_array_equal(zero.motion.poses.rotations, nan.motion.poses.rotations)
    off = errors(zero.motion, motion)
    assert np.delete(off, 25, 0).max() < 0.01
    assert zero.weights[7, [0, 9]].max() < 0.01 and zero.weights[8].min() > 0.1
    assert zero.lost.tolist() == [frame == 25 for frame in range(40)] and "25" in zero.messages[0]
    np.testing.assert_array_equal(zero.motion.poses.rotations[25], zero.motion.poses.rotations[24])
    assert np.isnan(zero.residuals).sum() == (~seen).sum()


def test_bones_that_no_pose_explains_are_named(rng):
    """A tenth of the markers does not change the median; all of a bone's markers elsewhere leave it any rotation."""
    frames = seen_by(SUBJECT, moving(rng), rng)
    places, own = np.array(frames.positions), np.flatnonzero(np.asarray(SUBJECT.bones) == 4)
    # out of the limb's reach
    places[10:21, own] += [0, 0, 2.0] + 0.3 * rng.normal(size=(11, len(own), 3))
    solved = solve_markers(SUBJECT, MarkerFrames(places, frames.visible, SUBJECT.labels, 100.0))
    name = SUBJECT.skeleton.names[4]
    assert not solved.lost.any() and len(solved.messages) == 1
    assert f"the markers of {name} in 11 frames (10 to 20)" in solved.messages[0]


def distant_starts(rng, motion, deviation):
    """Rotate the limbs of each frame by normal random vectors, radians."""
    steps = np.zeros((len(motion), SUBJECT.skeleton.num_dofs))
    steps[:, 6:] = deviation * rng.normal(size=steps[:, 6:].shape)
    return jax.vmap(retract, (None, 0, 0))(SUBJECT.skeleton, motion.poses, jnp.asarray(steps))


def test_distant_starts_lead_to_the_pose(rng):
    """Markers of a limb that is not in place are no outliers in a first search; without it, they remain so in some frames."""
    motion = moving(rng)
    frames = seen_by(SUBJECT, motion, rng)
    starts = distant_starts(rng, motion, 1.5)
    arrays = jnp.asarray(frames.positions), jnp.asarray(frames.visible)
    alone, found = (
        solve_each_frame(SUBJECT, starts, *arrays, search) for search in (INITIAL_SEARCH, LABELLED_SEARCH)
    )
    assert (np.asarray(alone.residuals) > FAR).any(1).sum() > 0
    assert np.asarray(found.residuals).max() < 0.01
    assert errors(Motion(found.pose, 100.0), motion).max() < 0.01


def test_a_single_marker_that_stays_far_off_is_solved_again(rng):
    """Other markers of the limb have no far residual, so that the pose follows a wrong minimum for as long as it exists."""
    motion = moving(rng)
    frames = seen_by(SUBJECT, motion, rng)
    positions, used = jnp.asarray(frames.positions), np.asarray(frames.visible)
    right = solve_each_frame(SUBJECT, motion.poses, positions, jnp.asarray(used), LABELLED_SEARCH)
    starts = eqx.tree_at(
        lambda p: p.rotations, motion.poses, motion.poses.rotations.at[:, 4].set([0, 1, 0, 0])
    )
    own = int(np.flatnonzero(np.asarray(SUBJECT.bones) == 4)[0])
    lengths = right.residuals.at[10:20, own].set(0.09)
    wrong = right._replace(
        pose=jax.tree.map(lambda a, b: a.at[10:20].set(b[10:20]), right.pose, starts), residuals=lengths
    )
    mended = solve_doubtful_frames(SUBJECT, positions, used, used.any(1), wrong, None)
    assert np.asarray(mended.residuals).max() < FAR
    assert errors(Motion(mended.pose, 100.0), motion).max() < 0.01


def test_a_limb_in_a_wrong_minimum_is_solved_again(rng):
    motion = moving(rng)
    frames = seen_by(SUBJECT, motion, rng, noise=0.0)
    positions, used = jnp.asarray(frames.positions), np.asarray(frames.visible)
    own = np.asarray(SUBJECT.bones) == 4
    starts = eqx.tree_at(
        lambda p: p.rotations, motion.poses, motion.poses.rotations.at[12:15, 4].set([0, 1, 0, 0])
    )
    lengths = np.linalg.norm(marker_residuals_of_frames(SUBJECT, starts, positions), axis=2)
    assert lengths[12:15][:, own].min() > FAR
    weights = np.where(lengths > FAR, 0.0, 1.0)
    wrong = SolvedFrame(starts, *(jnp.asarray(x) for x in (lengths, weights, np.ones(40), np.ones(40, int))))
    assert unexplained_bones(SUBJECT, used, lengths).sum() == 3
    # a solution that is not a number is never kept
    broken = wrong._replace(
        pose=eqx.tree_at(lambda p: p.rotations, starts, starts.rotations.at[13].set(jnp.nan)),
        residuals=wrong.residuals.at[13].set(jnp.nan),
        residual_scale=wrong.residual_scale.at[13].set(jnp.nan),
    )
    again = solve_doubtful_frames(SUBJECT, positions, used, used.any(1), broken, None)
    assert errors(Motion(again.pose, 100.0), motion).max() < 1e-4
    mended = solve_doubtful_frames(SUBJECT, positions, used, used.any(1), wrong, None)
    assert errors(Motion(mended.pose, 100.0), motion).max() < 1e-4
    np.testing.assert_array_equal(mended.pose.rotations[:12], starts.rotations[:12])


def test_order_of_markers_and_splitting_of_frames_change_nothing(rng):
    motion = moving(rng)
    frames = seen_by(SUBJECT, motion, rng)
    fine = SearchCriteria(max_iterations=40, tolerance=1e-7)
    whole = solve_markers(SUBJECT, frames, fine)
    order = rng.permutation(len(frames.labels))
    labels = tuple(frames.labels[i] for i in order) + ("ball",)
    places = np.concatenate([np.asarray(frames.positions)[:, order], np.ones((40, 1, 3))], 1)
    mixed = solve_markers(SUBJECT, MarkerFrames(places, np.ones((40, 19), bool), labels, 100.0), fine)
    np.testing.assert_array_equal(mixed.residuals, whole.residuals)
    assert "ball" in mixed.messages[0]
    halves = [solve_markers(SUBJECT, frames[part], fine) for part in (slice(0, 23), slice(23, 40))]
    parts = np.concatenate([np.asarray(_joints(half.motion.poses)) for half in halves])
    np.testing.assert_allclose(parts, _joints(whole.motion.poses), atol=1e-5)


def test_unseen_joints_stay(rng):
    motion = moving(rng)
    frames = seen_by(SUBJECT, motion, rng)
    seen = np.array(frames.visible)
    seen[10:, SUBJECT.bones == 2] = False
    solved = solve_markers(SUBJECT, MarkerFrames(frames.positions, seen, SUBJECT.labels, 100.0))
    rotations = np.asarray(solved.motion.poses.rotations)
    np.testing.assert_allclose(rotations[10:, 2], np.broadcast_to(rotations[9, 2], (30, 4)), atol=1e-12)
    assert errors(solved.motion, motion)[:, [0, 1, 3, 4]].max() < 0.01


def test_a_guess_needs_no_start(rng):
    """Any place and direction in the world, and bones turned by up to two radians."""
    motion = moving(rng, size=2.0)
    frames = seen_by(SUBJECT, motion, rng, noise=0.0)
    assert errors(solve_markers(SUBJECT, frames).motion, motion).max() < 1e-4


def test_streaming_is_solving(rng):
    motion = moving(rng)
    frames = seen_by(SUBJECT, motion, rng)
    whole = solve_markers(SUBJECT, frames)
    streamer, state = make_streamer(SUBJECT)
    places = np.array(frames.positions)
    places[30] = np.nan
    poses = []
    for place in places:
        state, pose = stream_frame(streamer, state, place)
        poses.append(pose)
    live = np.asarray(_joints(jax.tree.map(lambda *leaves: jnp.stack(leaves), *poses)))
    off = np.linalg.norm(live - np.asarray(_joints(whole.motion.poses)), axis=2)
    assert np.delete(off, 30, 0).max() < 5e-4
    np.testing.assert_array_equal(live[30], live[29])


def test_a_stream_leaves_a_wrong_minimum(rng):
    """A limb that another pose nearly explains keeps a marker far off; after `MIN_FAR_FRAMES` the stream searches again."""
    motion = moving(rng)
    frames = seen_by(SUBJECT, motion, rng)
    starts = distant_starts(rng, motion, 2.0)
    arrays = jnp.asarray(frames.positions), jnp.asarray(frames.visible)
    followed = solve_each_frame(SUBJECT, starts, *arrays, SearchCriteria())
    is_far = (np.asarray(followed.residuals) > FAR).any(1)
    wrong = np.flatnonzero(is_far & (np.asarray(followed.residual_scale) < 2.0))
    streamer, before = make_streamer(SUBJECT)
    remained = []
    for frame in wrong.tolist():
        place = np.asarray(frames.positions)[frame]
        state, _ = stream_frame(streamer, before, place)
        state = state._replace(pose=Motion(followed.pose)[frame])
        for _ in range(MIN_FAR_FRAMES - 1):
            state, _ = stream_frame(streamer, state, place)
        remained.append(np.count_nonzero(state.far_frames) > 0)
        state, pose = stream_frame(streamer, state, place)
        assert np.count_nonzero(state.far_frames) == 0
        found, expected = _joints(stack_trees([pose, motion[frame]]))
        np.testing.assert_allclose(found, expected, atol=0.01)
    assert any(remained)


def test_streamers_of_one_shape_share_their_programs():
    streamer, _ = make_streamer(SUBJECT)
    other, _ = make_streamer(shift_markers(SUBJECT, 0.01 * jnp.ones_like(SUBJECT.offsets)), SearchCriteria())
    assert streamer.call_arguments.structure == other.call_arguments.structure
    assert hash(streamer.call_arguments.structure) == hash(other.call_arguments.structure)


def test_copies_of_a_streamer_solve_frames():
    streamer, state = make_streamer(SUBJECT)
    places = np.asarray(SUBJECT.offsets)
    for other in (copy.deepcopy(streamer), pickle.loads(pickle.dumps(streamer))):
        found, _ = stream_frame(other, state, places)
        np.testing.assert_array_equal(found.residual_scale, stream_frame(streamer, state, places)[0][1])


def test_a_streamer_that_was_used_in_jit_has_no_tracers():
    streamer, state = make_streamer(SUBJECT)
    moved = eqx.tree_at(lambda s: s.subject.offsets, streamer, SUBJECT.offsets + 0.01)
    places = np.asarray(moved.subject.offsets)
    with pytest.raises(jax.errors.TracerArrayConversionError):
        jax.jit(lambda: stream_frame(moved, state, places)[1].rotations)()
    assert int(stream_frame(moved, state, places)[0].num_lost) == 0


def test_strangers_are_refused(rng):
    frames = seen_by(SUBJECT, moving(rng, 3), rng)
    with pytest.raises(ValueError, match="None of the frames' markers"):
        solve_markers(
            SUBJECT, MarkerFrames(frames.positions, frames.visible, tuple(map(str, range(18))), 100.0)
        )


def test_subjects_come_back_from_files(tmp_path):
    path = tmp_path / "subject.npz"
    save_subject(path, SUBJECT)
    back = load_subject(path)
    assert back.labels == SUBJECT.labels and back.models == SUBJECT.models
    same = jax.tree.map(lambda a, b: bool((a == b).all()), back, SUBJECT)
    assert all(jax.tree.leaves(same))
    path.write_bytes(path.read_bytes()[:300])
    with pytest.raises(InputError, match="npz file is incomplete"):
        load_subject(path)
