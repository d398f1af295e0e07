"""The pose prior of whole poses: a normal distribution over joint rotations, and that of people."""

import functools

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...arguments import check_fields, checked
from ...assets import asset_path
from ...body.pose import local_rotation_vectors
from ...body.skeleton import Skeleton
from ...geometry import rotation
from ...geometry.linear import factor_symmetric, inverse_symmetric
from ...limits.rotation_vector_boxes import rotating_joints
from ...prior.pair_prior import MAX_FRAME_ANGLE
from ..energy import AbstractEnergy

#: file of the prior of people's poses, by `scripts/build_pose_prior.py`
HUMAN_PRIOR = "human_pose_prior.npz"
#: joints without which a skeleton is not a person's
REQUIRED_JOINTS = ("LeftArm", "RightArm", "LeftForeArm", "RightForeArm", "LeftUpLeg", "RightUpLeg", "LeftLeg", "RightLeg")  # fmt: skip


class GaussianPrior(AbstractEnergy):
    """`|L^T (x - mean)|^2`, the squared Mahalanobis distance of a pose, over the rotation vectors `x` of some joints
    from rest, each in its joint's own frame.

    Joints are coupled: what some joints show predicts the others.
    """

    #: indices of the joints
    joints: tuple[int, ...] = eqx.field(static=True)
    mean: Float[Array, "J 3"]
    #: lower triangular `L`, with `L L^T` the inverse of the covariance
    factor: Float[Array, "D D"]

    def __check_init__(self):
        check_fields(self)

    def residual(self, posed) -> Float[Array, "D"]:
        vectors = local_rotation_vectors(posed.body.skeleton, posed.pose)[jnp.asarray(self.joints)]
        return (vectors - self.mean).reshape(-1) @ self.factor


@checked
def human_prior(skeleton: Skeleton) -> GaussianPrior | None:
    """Return the prior of people's poses for a skeleton with the joint names of the embedded human.

    It was learned from motions of the CMU database: walking, punching, sword play, climbing. Joints without a known
    name are free. The result is None if the skeleton lacks main joints of a person, or has another rest pose.
    """
    names, frames, mean, covariance = _stored_prior()
    if not set(REQUIRED_JOINTS) <= set(skeleton.names):
        return None
    rotating = {skeleton.names[joint] for joint in rotating_joints(skeleton)}
    known = [row for row, name in enumerate(names) if name in rotating]
    joints = [skeleton.index(names[row]) for row in known]
    angles = rotation.distance(jnp.asarray(frames[known]), skeleton.orientations[jnp.asarray(joints)])
    if float(jnp.max(angles)) > MAX_FRAME_ANGLE:
        return None
    columns = (3 * np.array(known)[:, None] + np.arange(3)).reshape(-1)
    # the marginal distribution of the joints that the skeleton has
    precision = inverse_symmetric(covariance[np.ix_(columns, columns)])
    dtype = skeleton.centres.dtype
    return GaussianPrior(
        tuple(joints), jnp.asarray(mean[known], dtype), jnp.asarray(factor_symmetric(precision), dtype)
    )


@functools.cache
def _stored_prior() -> tuple[tuple[str, ...], np.ndarray, np.ndarray, np.ndarray]:
    with np.load(asset_path(HUMAN_PRIOR)) as stored:
        return (
            tuple(str(name) for name in stored["names"]),
            stored["frames"],
            stored["mean"].astype(float),
            stored["covariance"].astype(float),
        )
