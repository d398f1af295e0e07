"""Keys: motions that few keys made are found to be so, and tolerances are kept."""

import jax.numpy as jnp
import numpy as np
import pytest
from helpers import chain_skeleton

from jaxcap.body.kinematics import joint_paths
from jaxcap.body.pose import Motion, Pose
from jaxcap.edit.keys import find_keys, interpolate_keys
from jaxcap.geometry import rotation


def smooth_motion(rng, frames=60, joints=9):
    t = np.arange(frames)[:, None, None]
    waves = sum(
        rng.normal(size=(1, joints, 3)) / k * np.sin(0.04 * k * t + rng.uniform(0, 6, (1, joints, 3)))
        for k in (1, 2, 3)
    )
    translations = np.zeros((frames, joints, 3))
    translations[:, 0] = 0.1 * waves[:, 0]
    return Motion(
        Pose(jnp.asarray(translations), rotation.exp(jnp.asarray(0.5 * waves)), jnp.ones(frames)), 30.0
    )


def keyed_motion(rng, keys):
    """A motion that is interpolated between whole poses at `keys`."""
    keyed = np.zeros((keys[-1] + 1, 9), bool)
    keyed[keys] = True
    return Motion(interpolate_keys(smooth_motion(rng, keys[-1] + 1).poses, keyed), 30.0)


def errors(skeleton, motion, found):
    turned = np.degrees(np.asarray(rotation.distance(motion.poses.rotations, found.poses.rotations)))
    apart = np.asarray(joint_paths(skeleton, motion.poses) - joint_paths(skeleton, found.poses))
    return turned.max(), np.linalg.norm(apart, axis=-1).max()


def test_interpolated_motions_give_their_keys_back(rng):
    keys = [0, 7, 19, 23, 40, 59]
    motion = keyed_motion(rng, keys)
    found = find_keys(chain_skeleton(), motion, 1e-4, 1e-7)
    assert np.flatnonzero(found.is_key[:, 0]).tolist() == keys
    np.testing.assert_allclose(found.motion.poses.rotations, motion.poses.rotations, atol=1e-7)
    # keys are the motion's own poses, to the last bit
    np.testing.assert_array_equal(
        found.motion.poses.rotations[np.array(keys)], motion.poses.rotations[np.array(keys)]
    )


@pytest.mark.parametrize("per_joint", [False, True])
def test_tolerances_are_kept_and_tell_the_truth(rng, per_joint):
    skeleton, motion = chain_skeleton(), smooth_motion(rng)
    before = None
    for degrees, metres in ((20.0, 0.1), (5.0, 0.02), (2.0, 0.005)):
        found = find_keys(skeleton, motion, degrees, metres, per_joint)
        turned, moved = errors(skeleton, motion, found.motion)
        assert turned <= degrees and moved <= metres
        assert found.degrees == pytest.approx(turned) and found.metres == pytest.approx(moved)
        assert before is None or found.count > before
        before = found.count
    assert before < 60 * 9


def test_no_key_can_be_left_out(rng):
    skeleton, motion = chain_skeleton(), smooth_motion(rng)
    found = find_keys(skeleton, motion, 5.0, 0.02)
    for frame in np.flatnonzero(found.is_key[1:-1, 0]) + 1:
        fewer = found.is_key.copy()
        fewer[frame] = False
        turned, moved = errors(skeleton, motion, Motion(interpolate_keys(motion.poses, fewer), 30.0))
        assert turned > 5.0 or moved > 0.02


def test_still_joints_have_two_keys_of_their_own(rng):
    skeleton, motion = chain_skeleton(), smooth_motion(rng)
    rotations = motion.poses.rotations.at[:, jnp.array([1, 6])].set(
        motion.poses.rotations[0, jnp.array([1, 6])]
    )
    motion = Motion(Pose(motion.poses.translations, rotations, motion.poses.scale), 30.0)
    found = find_keys(skeleton, motion, 2.0, 0.5, per_joint=True)
    assert found.is_key[:, [1, 6]].sum(0).tolist() == [2, 2]
    assert found.count < find_keys(skeleton, motion, 2.0, 0.5).count


def test_what_cannot_be_keyed_is_told(rng):
    skeleton, motion = chain_skeleton(), smooth_motion(rng, 4)
    with pytest.raises(ValueError, match="0 degrees"):
        find_keys(skeleton, motion, 0.0)
    with pytest.raises(ValueError, match="-1 metres"):
        find_keys(skeleton, motion, 1.0, -1)
    with pytest.raises(ValueError, match="no frames"):
        find_keys(skeleton, motion.slice(slice(0, 0)))
    one = find_keys(skeleton, motion.slice(slice(0, 1)))
    assert one.count == 9 and one.degrees < 1e-9
