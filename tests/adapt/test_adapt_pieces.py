"""Stages that go through the frames: in pieces they are what they are in one go, and from the file of any piece on."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from adapt_scene import make_scene, task_of

import jaxcap as jc
from jaxcap.adapt import adapt_body as loop
from jaxcap.adapt.adapt_body import adapt_body
from jaxcap.adapt.objective import Terms
from jaxcap.adapt.task import AdaptSettings, AdaptState, plan_stages
from jaxcap.body.pose import Motion, Pose, stack_poses
from jaxcap.body.retraction import retract
from jaxcap.cli.adapt.state import keep_state, load_resumed_state

HEADER = {"who": "a test"}


@pytest.fixture(scope="module")
def scene():
    return make_scene()


def before_stage(scene, name: str, **changes):
    """The task, and a state whose next stage is the last of a name, with poses that are off."""
    _, actor, poses, _ = scene
    task = task_of(scene)._replace(
        settings=AdaptSettings(num_frames=3, proportion_rounds=1, rounds=(1,)), **changes
    )
    way = jnp.asarray(0.02 * np.random.default_rng(2).normal(size=actor.skeleton.num_dofs))
    off = stack_poses([retract(actor.skeleton, pose, way) for pose in poses], 10.0)
    names = [stage.name for stage in plan_stages(task.settings)]
    done = len(names) - 1 - names[::-1].index(name)
    terms = (Terms(1e-5, 1.0, 1e-3, 0.0, 0.0),)
    return task, AdaptState(done, actor, 1.0, off, pose_weight=1e-8, terms=terms, history=(("size", 3.0),))


def stage_of(task, state: AdaptState, every: int = 0) -> list[AdaptState]:
    """What is reached within the next stage, and at its end."""
    reached = []
    for one in adapt_body(task, state, every):
        reached.append(one)
        if one.done > state.done:
            return reached
    raise AssertionError("the stage has no end")


@pytest.mark.parametrize(
    ("name", "pieces"), [("track", [2, 4]), ("turn", [2, 4]), ("pose", [2, 4]), ("smooth", [2])]
)
def test_pieces_are_the_whole_and_any_can_be_gone_on_from(scene, name, pieces, tmp_path, monkeypatch):
    monkeypatch.setattr(loop, "smooth_windows", partial(loop.smooth_windows, frames=4, stride=2))
    # any poses other than those given are hands that were turned
    monkeypatch.setattr(loop, "flip_limb_ends", lambda tracker, clouds, poses: scene[2][:3])
    task, before = before_stage(scene, name)
    (whole,) = stage_of(task, before)
    reached = stage_of(task, before, every=2)
    assert [(state.done - before.done, state.within) for state in reached] == [
        *((0, within) for within in pieces),
        (1, 0),
    ]
    assert np.abs(np.asarray(whole.motion.poses.rotations - before.motion.poses.rotations)).max() > 1e-3
    ends = [reached[-1]]
    # hands that are turned over already are not looked for again
    monkeypatch.setattr(loop, "flip_limb_ends", None)
    for state in reached[:-1]:
        keep_state(tmp_path / "kept", state, HEADER)
        kept = load_resumed_state(tmp_path / "kept", HEADER, resume=True, overwrite=False)
        ends.append(stage_of(task, kept)[-1])
    for end in ends:
        assert end._replace(body=whole.body, motion=whole.motion) == whole
        for one, other in zip(*map(jax.tree.leaves, (whole.motion, end.motion)), strict=True):
            np.testing.assert_array_equal(one, other)


def test_frames_that_are_not_done_are_as_they_were(scene):
    task, before = before_stage(scene, "pose")
    state = stage_of(task, before, every=4)[0]
    np.testing.assert_array_equal(state.motion[5].rotations, before.motion[5].rotations)
    assert np.abs(np.asarray(state.motion[0].rotations - before.motion[0].rotations)).max() > 1e-4


def test_scans_that_the_body_was_adapted_to_are_not_tracked_again(scene):
    """Unless one of them is lost, or others were not adapted to."""
    task, before = before_stage(scene, "track")
    every = tuple(range(task.num_frames))
    (kept,) = stage_of(task, before._replace(chosen=every))
    np.testing.assert_array_equal(kept.motion.poses.rotations, before.motion.poses.rotations)
    assert kept.chosen == every and kept.history[-1][0] == "track"
    for other in ({"chosen": every, "lost": (1,)}, {"chosen": every[1:]}):
        (tracked,) = stage_of(task, before._replace(**other))
        assert tracked.chosen == ()
        assert np.abs(np.asarray(tracked.motion.poses.rotations - kept.motion.poses.rotations)).max() > 1e-3


def test_scans_that_the_body_does_not_explain_any_more_are_tracked_again(scene):
    """Although none was lost when the body was adapted to them."""
    task, before = before_stage(scene, "track")
    poses = before.motion.poses
    far = poses.translations.at[1].add(jnp.array([0.3, 0.0, 0.0]))
    motion = Motion(Pose(far, poses.rotations, poses.scale), before.motion.rate)
    (found,) = stage_of(task, before._replace(motion=motion, chosen=tuple(range(task.num_frames))))
    assert found.chosen == () and 1 not in found.lost
    np.testing.assert_allclose(found.motion.poses.translations[1], scene[2][1].translations, atol=0.02)


def test_flipped_hands_are_tracked_again_in_scans_that_the_body_was_adapted_to(scene, monkeypatch):
    monkeypatch.setattr(loop, "flip_limb_ends", lambda tracker, clouds, poses: scene[2][:3])
    task, before = before_stage(scene, "turn")
    before = before._replace(chosen=tuple(range(task.num_frames)))
    (found,) = stage_of(task, before)
    assert found.chosen == ()
    assert np.abs(np.asarray(found.motion.poses.rotations - before.motion.poses.rotations)).max() > 1e-3


def test_lost_and_missing_frames_are_told_from_any_piece_on(scene):
    """Also those before the piece that is gone on from."""
    noise = np.random.default_rng(3).uniform(-1.0, 1.0, (600, 3))

    def cloud(number):
        return jc.make_cloud(noise, noise) if number in (1, 4) else task_of(scene).cloud(number)

    task, before = before_stage(scene, "track", cloud=cloud, missing=(3,))
    (whole,) = stage_of(task, before)
    assert set(whole.lost) > {1, 3}
    for state in stage_of(task, before._replace(lost=(0, 3)), every=1)[:-1]:
        end = stage_of(task, state)[-1]
        assert end.lost == whole.lost
        # those that are searched for are searched for from the same random starts
        np.testing.assert_array_equal(end.motion.poses.rotations, whole.motion.poses.rotations)


def test_what_a_cloud_cannot_be_read_for_is_told_as_it_is(scene):
    """And only of one without points, that its frame may be left out."""

    def unreadable(number):
        raise jc.InputError("scan_0002.ply: cannot be read; check the path.")

    def empty(number):
        return jc.make_cloud(np.ones((9, 3)), np.ones((9, 3)), np.zeros(9))

    with pytest.raises(jc.InputError, match=r"^scan_0002.ply: cannot be read; check the path.$"):
        task_of(scene, cloud=unreadable).scan(2)
    with pytest.raises(jc.InputError, match=r"^frame 2: .* no points .* Add it to the `missing` frames.$"):
        task_of(scene, cloud=empty).scan(2)
