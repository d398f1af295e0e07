"""Starts of a search at the mean of the prior of people's poses."""

import jax
import jax.numpy as jnp
import numpy as np

import jaxcap as jc
from jaxcap.body.body import pose_body
from jaxcap.body.retraction import retract
from jaxcap.energy.priors.human_prior import human_prior
from jaxcap.tracking.search.prior_starts import LIMBS, limb_starts, mean_pose, upright_starts

BODY = jc.human(resolution="low", joints="tracking")
PRIOR = human_prior(BODY.skeleton)


def test_the_mean_pose_costs_nothing():
    skeleton = BODY.skeleton
    rest, mean = (
        PRIOR.residual(pose_body(BODY, pose)) for pose in (jc.rest_pose(skeleton), mean_pose(PRIOR, skeleton))
    )
    assert float(rest @ rest) > 1.0
    assert float(mean @ mean) < 1e-4


def test_each_start_moves_its_limbs_only(rng):
    skeleton = BODY.skeleton
    turned = jnp.asarray(rng.normal(size=(2, skeleton.num_joints, 4)), skeleton.centres.dtype)
    turned = turned / jnp.linalg.norm(turned, axis=-1, keepdims=True)
    rest = jc.rest_pose(skeleton)
    poses = jc.Pose(jnp.stack([rest.translations] * 2), turned, jnp.stack([rest.scale] * 2))
    starts = limb_starts(PRIOR, skeleton, poses)
    assert jax.tree.map(len, starts) == jax.tree.map(lambda _: 2 * len(LIMBS), starts)
    mean = np.asarray(mean_pose(PRIOR, skeleton).rotations)
    for number, limb in enumerate(LIMBS):
        below = np.any([skeleton.descendants[skeleton.index(name)] for name in limb], axis=0)
        found = np.asarray(starts.rotations)[2 * number : 2 * number + 2]
        assert np.array_equal(found[:, ~below], np.asarray(turned)[:, ~below])
        assert np.array_equal(found[0, below], mean[below]) and np.array_equal(found[1, below], mean[below])


def test_an_upright_start_keeps_chest_head_and_arms_in_place(rng):
    skeleton = BODY.skeleton
    tangent = jnp.asarray(0.5 * rng.normal(size=(2, skeleton.num_dofs)), skeleton.centres.dtype)
    poses = jax.vmap(retract, (None, None, 0))(skeleton, jc.rest_pose(skeleton), tangent)
    poses = jc.Pose(poses.translations, poses.rotations, jnp.asarray([1.0, 1.2], poses.scale.dtype))
    starts = upright_starts(PRIOR, skeleton, poses)
    before, after = (jax.vmap(pose_body, (None, 0))(BODY, stack).joints for stack in (poses, starts))
    kept = [skeleton.index(name) for name in ("LeftArm", "RightArm", "LeftHand", "RightForeArm", "Head")]
    np.testing.assert_allclose(after[:, kept], before[:, kept], atol=1e-5)
    mean = mean_pose(PRIOR, skeleton).rotations
    legs = [skeleton.index(name) for name in ("LeftUpLeg", "RightUpLeg", "LeftLeg")]
    np.testing.assert_array_equal(starts.rotations[:, legs], jnp.stack([mean[jnp.asarray(legs)]] * 2))
    assert np.abs(after - before)[:, legs].max() > 0.05
