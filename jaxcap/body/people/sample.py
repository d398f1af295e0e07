"""Poses to try a body in: made where no motion is at hand, and picked from many."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Int

from ...arguments import checked
from ...geometry import rotation
from ..kinematics import joint_paths
from ..pose import Pose, project, rest_pose
from ..skeleton import Skeleton
from .anatomy import rest_deviations

#: radians about every axis of a joint that no anatomy knows, and the deviations that none exceeds
_UNKNOWN, _MOST = 0.5, 2.0


@checked
def sample_poses(skeleton: Skeleton, count: int = 64, seed: int = 0) -> Pose:
    """`count` poses stacked, the rest pose first, the same for one seed.

    Joints turn about the axes of their own frames by normal numbers, with the deviations of
    `rest_deviations` where the skeleton has human names, and none beyond twice that. Roots stay.

    **Raises:** `ValueError` where `count` is not positive.
    """
    if count < 1:
        raise ValueError(f"{count} poses were to be sampled; ask for at least 1.")
    deviations = rest_deviations(skeleton, _UNKNOWN)
    deviations = np.where(np.isfinite(deviations), deviations, 0.0)
    normal = np.random.default_rng(seed).normal(size=(count, skeleton.num_joints, 3))
    turns = np.clip(normal, -_MOST, _MOST) * deviations
    turns[0] = 0.0
    return _turned(skeleton, jnp.asarray(turns, skeleton.centres.dtype))


@eqx.filter_jit
def _turned(skeleton: Skeleton, turns: jax.Array) -> Pose:
    rest = rest_pose(skeleton)

    def one(own):
        turn = rotation.exp(rotation.rotate(skeleton.orientations, own))
        return project(skeleton, Pose(rest.translations, turn, rest.scale))

    return jax.vmap(one)(turns)


def unlike_poses(skeleton: Skeleton, poses: Pose, count: int) -> Int[np.ndarray, "N"]:
    """At most `count` numbers of stacked poses in rising order: the first, and then each the furthest from those
    before, by the places of joints about the root."""
    joints = np.asarray(joint_paths(skeleton, poses), float)
    joints = (joints - joints[:, :1]).reshape(len(joints), -1)
    chosen, apart = [0], np.linalg.norm(joints - joints[0], axis=1)
    while len(chosen) < min(count, len(joints)):
        chosen.append(int(np.argmax(apart)))
        apart = np.minimum(apart, np.linalg.norm(joints - joints[chosen[-1]], axis=1))
    return np.unique(chosen)
