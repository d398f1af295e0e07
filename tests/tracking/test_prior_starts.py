"""Starts of a search at the mean of the prior of people's poses."""

import jax
import jax.numpy as jnp
import numpy as np

import jaxcap as jc
from jaxcap.body.body import pose_body
from jaxcap.energy.priors.gaussian_pose_prior import human_prior
from jaxcap.tracking.prior_starts import LIMBS, limb_starts, mean_pose

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
