"""Sampled poses for tests of a body, and selection of diverse poses."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Int

from ...arguments import checked
from ...geometry import rotation
from ...geometry.sampling import farthest_points
from ..kinematics import joint_paths
from ..pose import Pose, rest_pose
from ..retraction import project
from ..skeleton import Skeleton
from .anatomy import rest_deviations

#: standard deviation of joints without known anatomy, radians; largest multiple of the deviation
_DEFAULT_DEVIATION, _MAX_DEVIATIONS = 0.5, 2.0


@checked
def sample_poses(skeleton: Skeleton, count: int = 64, seed: int = 0) -> Pose:
    """Sample `count` stacked poses, the rest pose first; deterministic for a seed.

    Joints rotate about the axes of their own frames by normal random angles. Their deviations are those of
    `rest_deviations` where the skeleton has human names. Angles are clipped at twice the deviation. Roots
    do not move.

    **Raises:** `ValueError` where `count` is not positive.
    """
    if count < 1:
        raise ValueError(f"The number of poses is {count}; expected at least 1.")
    deviations = rest_deviations(skeleton, _DEFAULT_DEVIATION)
    deviations = np.where(np.isfinite(deviations), deviations, 0.0)
    normal = np.random.default_rng(seed).normal(size=(count, skeleton.num_joints, 3))
    turns = np.clip(normal, -_MAX_DEVIATIONS, _MAX_DEVIATIONS) * deviations
    turns[0] = 0.0
    return _pose_from_vectors(skeleton, jnp.asarray(turns, skeleton.centres.dtype))


@eqx.filter_jit
def _pose_from_vectors(skeleton: Skeleton, vectors: jax.Array) -> Pose:
    rest = rest_pose(skeleton)

    def one(own):
        turn = rotation.exp(rotation.rotate(skeleton.orientations, own))
        return project(skeleton, Pose(rest.translations, turn, rest.scale))

    return jax.vmap(one)(vectors)


def select_diverse_poses(skeleton: Skeleton, poses: Pose, count: int) -> Int[np.ndarray, "N"]:
    """Select at most `count` diverse poses of a stack by farthest-point sampling, as ascending indices.

    The first pose is always selected. Distances are those of joint positions relative to the root.
    """
    joints = np.asarray(joint_paths(skeleton, poses), float)
    joints = (joints - joints[:, :1]).reshape(len(joints), -1)
    return farthest_points(joints, count, 0)
