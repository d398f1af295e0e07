"""The prior of people's poses, for the embedded human and for other skeletons of a person."""

import functools
from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy.spatial.transform import Rotation

from ...arguments import checked
from ...assets import asset_path
from ...body.matching.follow_joints import follow_joints
from ...body.matching.person_joints import has_named_limbs
from ...body.matching.plan import RetargetPlan, plan_retarget
from ...body.matching.upright_pose import joint_transforms
from ...body.people.human import human
from ...body.pose import Pose
from ...body.skeleton import Skeleton
from ...geometry import rotation
from ...geometry.linear import factor_symmetric, inverse, inverse_symmetric
from ...limits.rotation_vector_boxes import rotating_joints
from ...prior.pair_prior import MAX_FRAME_ANGLE
from .gaussian_pose_prior import GaussianPrior

#: file of the prior of people's poses, by `scripts/build_pose_prior.py`
HUMAN_PRIOR = "human_pose_prior.npz"
#: joints without which a skeleton is not a person's
REQUIRED_JOINTS = ("LeftArm", "RightArm", "LeftForeArm", "RightForeArm", "LeftUpLeg", "RightUpLeg", "LeftLeg", "RightLeg")  # fmt: skip
#: poses that carry the prior to another skeleton
NUM_SAMPLES = 1024
#: least standard deviation in any direction, radians: that of the stored prior
MIN_DEVIATION = 0.1
#: joints whose rotations vary less than this do not follow the person, radians
STILL = 1e-3

Samples = Float[np.ndarray, "N J 3"]


@checked
def human_prior(skeleton: Skeleton) -> GaussianPrior | None:
    """Return the prior of people's poses for a skeleton of a person.

    It was learned from motions of the CMU database: walking, punching, sword play, climbing. A skeleton with the joint names
    and the rest pose of the embedded human has the marginal distribution of its joints. For another one with names of a
    person's joints, such as those of SMPL, samples of the prior are retargeted, as `jaxcap.retarget` does, and the normal
    distribution of their rotations is the prior. Joints without a counterpart are free.

    The result is None if the skeleton lacks arms or legs of a person, or their names are not known.
    """
    return _own_prior(skeleton) or _transferred_prior(skeleton)


def _own_prior(skeleton: Skeleton) -> GaussianPrior | None:
    """Select the joints of a skeleton with the names and the rest pose of the embedded human; None for another one."""
    if not has_human_frames(skeleton):
        return None
    names, _, mean, covariance = _marginal_prior(skeleton)
    joints = [skeleton.index(name) for name in names]
    return _make_prior(skeleton, joints, mean, inverse_symmetric(covariance), names)


def has_human_frames(skeleton: Skeleton) -> bool:
    """Test if a skeleton has the joint names of the embedded human, with the same frames at rest."""
    if not set(REQUIRED_JOINTS) <= set(skeleton.names):
        return False
    names, frames, _, _ = _marginal_prior(skeleton)
    own = skeleton.orientations[jnp.asarray([skeleton.index(name) for name in names])]
    return bool(jnp.max(rotation.distance(jnp.asarray(frames), own)) <= MAX_FRAME_ANGLE)


def _make_prior(
    skeleton: Skeleton, joints: Sequence[int], mean: np.ndarray, precision: np.ndarray, roles: Sequence[str]
) -> GaussianPrior:
    dtype = skeleton.centres.dtype
    factor = jnp.asarray(factor_symmetric(precision), dtype)
    return GaussianPrior(tuple(joints), jnp.asarray(mean.reshape(-1, 3), dtype), factor, tuple(roles))


def _transferred_prior(skeleton: Skeleton) -> GaussianPrior | None:
    """Retarget samples of the prior to another skeleton of a person, and fit a normal distribution; None if it is not one."""
    if not has_named_limbs(skeleton):
        return None
    source = human(resolution="low", joints="tracking").skeleton
    try:
        plan = plan_retarget(source, skeleton)
    except ValueError:
        # limbs without a match, or a rest pose that is not upright
        return None
    spread, pairs = _carry_samples(source, skeleton, plan), plan.matches.pairs
    moving = set(np.flatnonzero(spread.std(0).max(-1) > STILL)) & set(rotating_joints(skeleton))
    joints = sorted(int(joint) for joint in moving)
    vectors = spread[:, joints].reshape(len(spread), -1)
    values, axes = np.linalg.eigh(np.cov(vectors.T))
    precision = (axes / np.maximum(values, MIN_DEVIATION**2)) @ axes.T
    roles = [source.names[pairs[joint]] if joint in pairs else "" for joint in joints]
    return _make_prior(skeleton, joints, vectors.mean(0), precision, roles)


def _carry_samples(source: Skeleton, skeleton: Skeleton, plan: RetargetPlan) -> Samples:
    """Retarget poses of the prior: the rotation vectors of all joints from rest, in their own frames."""
    names, _, mean, covariance = _marginal_prior(source)
    vectors = np.concatenate([mean.reshape(1, -1), mean.reshape(1, -1) + _even_normals(covariance)])
    joints, count = [source.index(name) for name in names], len(vectors)
    turns = Rotation.from_quat(_scipy(source.orientations)[joints][None].repeat(count, 0).reshape(-1, 4))
    turns = Rotation.from_rotvec(turns.apply(vectors.reshape(-1, 3))).as_quat(scalar_first=True)
    rotations = np.tile([1.0, 0, 0, 0], (count, source.num_joints, 1))
    rotations[:, joints] = turns.reshape(count, -1, 4)
    turns = retarget_rotation_vectors(source, skeleton, plan, jnp.asarray(rotations))
    frames = Rotation.from_quat(np.tile(_scipy(skeleton.orientations), (count, 1)))
    found = frames.inv().apply(turns.reshape(-1, 3)).reshape(count, -1, 3)
    return _nearest_turns(found[1:], found[0])


def retarget_rotation_vectors(
    source: Skeleton, skeleton: Skeleton, plan: RetargetPlan, rotations: Float[Array, "N S 4"]
) -> Samples:
    """Retarget rotations of the joints of `source` from rest; return rotation vectors in the rest frame of the world."""
    count = len(rotations)
    poses = Pose(jnp.zeros((count, source.num_joints, 3)), rotations, jnp.ones(count))
    followed = follow_joints(skeleton, plan, joint_transforms(source, poses)[1], np.zeros((count, 3)))
    turns = Rotation.from_quat(_scipy(followed.rotations).reshape(-1, 4)).as_rotvec()
    return turns.reshape(count, -1, 3)


def _scipy(quaternions: Float[Array, "... 4"]) -> Float[np.ndarray, "... 4"]:
    """Convert quaternions to the order of SciPy, the scalar last."""
    return np.asarray(quaternions, float)[..., [1, 2, 3, 0]]


def _even_normals(covariance: Float[np.ndarray, "D D"]) -> Float[np.ndarray, "S D"]:
    """Sample a normal distribution around zero; the samples have exactly this mean and covariance."""
    samples = np.random.default_rng(0).normal(size=(NUM_SAMPLES, len(covariance)))
    samples -= samples.mean(0)
    own, wanted = factor_symmetric(np.cov(samples.T)), factor_symmetric(covariance)
    return samples @ inverse(own).T @ wanted.T


def _nearest_turns(vectors: Samples, middle: Float[np.ndarray, "J 3"]) -> Samples:
    """Choose the rotation vectors, of those of the same rotations, that are nearest to those in the middle."""
    angles = np.linalg.norm(vectors, axis=-1, keepdims=True)
    others = vectors * (1.0 - 2 * np.pi / np.maximum(angles, 1e-9))
    near, far = (np.linalg.norm(each - middle, axis=-1, keepdims=True) for each in (vectors, others))
    return np.where(far < near, others, vectors)


def _marginal_prior(
    skeleton: Skeleton,
) -> tuple[tuple[str, ...], Float[np.ndarray, "J 4"], Float[np.ndarray, "J 3"], Float[np.ndarray, "D D"]]:
    """Read the prior of the joints of a skeleton that rotate, by their names: names, frames, mean and covariance."""
    names, frames, mean, covariance = _stored_prior()
    rotating = {skeleton.names[joint] for joint in rotating_joints(skeleton)}
    known = [row for row, name in enumerate(names) if name in rotating]
    columns = (3 * np.array(known)[:, None] + np.arange(3)).reshape(-1)
    chosen = tuple(names[row] for row in known)
    return chosen, frames[known], mean[known], covariance[np.ix_(columns, columns)]


@functools.cache
def _stored_prior() -> tuple[tuple[str, ...], np.ndarray, np.ndarray, np.ndarray]:
    with np.load(asset_path(HUMAN_PRIOR)) as stored:
        return (
            tuple(str(name) for name in stored["names"]),
            stored["frames"],
            stored["mean"].astype(float),
            stored["covariance"].astype(float),
        )
