"""Learn pose priors and joint limits from sample poses; `energy.priors` has their energies."""

from collections.abc import Callable, Iterable, Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Float

from ..arguments import checked
from ..body.pose import Motion, Pose, concatenate_poses, local_rotation_vectors
from ..body.skeleton import Skeleton
from ..geometry.linear import factor_symmetric
from ..limits.rotation_vector_boxes import PoseBoxes, make_pose_boxes, rotating_joints
from .gaussian_mixture import MIN_DEVIATION
from .model_selection import MixtureSelection, select_mixture
from .pair_prior import PairPrior, make_pair_prior, successive_pairs

#: training poses: a motion, several motions of one skeleton, or poses stacked over frames
Poses = Motion | Pose | Sequence[Motion]

_local_rotation_vectors = eqx.filter_jit(jax.vmap(local_rotation_vectors, (None, 0)))


class LearnedPair(NamedTuple):
    """A joint and its parent, the parent first, and their selected mixture."""

    pair: tuple[str, str]
    selection: MixtureSelection


@checked
def learn_pair_prior(
    skeleton: Skeleton,
    poses: Poses,
    *,
    max_components: int = 10,
    min_deviation: float = MIN_DEVIATION,
    seed: int = 0,
) -> PairPrior:
    """Fit a Gaussian mixture over the rotations of each joint and its parent.

    Each mixture has the number of components, 1 to `max_components`, that best predicts left-out poses (Adaptation,
    section 4.1.1 and eq. 4.1).

    **Arguments:** `min_deviation` is the least standard deviation of a component in any direction, radians. It is the
    only regularisation of a joint that never moved.

    **Raises:** `ValueError` if no joint rotates whose parent rotates, if there are fewer than 4 poses, if poses
    have another number of joints, or if one is not finite.
    """
    return build_pair_prior(
        skeleton,
        learn_pairs(skeleton, poses, max_components=max_components, min_deviation=min_deviation, seed=seed),
    )


def learn_pairs(
    skeleton: Skeleton,
    poses: Poses,
    *,
    max_components: int = 10,
    min_deviation: float = MIN_DEVIATION,
    seed: int = 0,
    progress: Callable[[Iterable, int], Iterable] = lambda pairs, total: pairs,
) -> tuple[LearnedPair, ...]:
    """Fit the mixtures of `learn_pair_prior` and return how each was selected; `progress` wraps the loop over
    pairs."""
    vectors = rotation_vectors(skeleton, poses)
    pairs = successive_pairs(skeleton)
    if not pairs:
        raise ValueError(
            "The skeleton has no joint that rotates with a parent that rotates; expected at least one."
        )
    learned = []
    for above, below in progress(pairs, len(pairs)):
        both = np.concatenate([vectors[:, skeleton.index(name)] for name in (above, below)], 1)
        learned.append(
            LearnedPair(
                (above, below),
                select_mixture(both, max_components=max_components, min_deviation=min_deviation, seed=seed),
            )
        )
    return tuple(learned)


def build_pair_prior(skeleton: Skeleton, learned: Sequence[LearnedPair]) -> PairPrior:
    """Build the prior from learned pairs, padded to the largest number of components."""
    width = max(len(one.selection.mixture.weights) for one in learned)
    weights, means = np.zeros((len(learned), width)), np.zeros((len(learned), width, 6))
    factors = np.tile(np.eye(6), (len(learned), width, 1, 1))
    frames = np.zeros((len(learned), 2, 4))
    for row, (pair, chosen) in enumerate(learned):
        count = len(chosen.mixture.weights)
        weights[row, :count], means[row, :count] = chosen.mixture.weights, chosen.mixture.means
        factors[row, :count] = factor_symmetric(chosen.mixture.precisions)
        frames[row] = [skeleton.orientations[skeleton.index(name)] for name in pair]
    return make_pair_prior(tuple(one.pair for one in learned), frames, weights, means, factors)


@checked
def learn_ranges(skeleton: Skeleton, poses: Poses, margin: float = 0.0) -> PoseBoxes:
    """Learn hard limits: the least and the largest value of each rotation vector component of each joint.

    `margin` radians are added at both ends. Roots are free (Adaptation, section 4.1.1).

    **Raises:** `ValueError` if there is no pose, if poses have another number of joints, or if one is not
    finite.
    """
    joints = list(rotating_joints(skeleton))
    vectors = rotation_vectors(skeleton, poses)[:, joints]
    names = tuple(skeleton.names[joint] for joint in joints)
    return make_pose_boxes(names, vectors.min(0) - margin, vectors.max(0) + margin)


def rotation_vectors(skeleton: Skeleton, poses: Poses) -> Float[np.ndarray, "F J 3"]:
    """Compute the rotation of each joint from rest in each pose: rotation vectors in the joint frames,
    radians.

    **Raises:** `ValueError` if there is no pose, if poses have another number of joints, or if one is not
    finite.
    """
    stacked = _poses_of_motions(poses)
    if stacked.rotations.ndim != 3 or not len(stacked.rotations):
        raise ValueError("There are no poses to learn from; give poses stacked over frames.")
    joints = stacked.rotations.shape[1]
    if joints != skeleton.num_joints:
        raise ValueError(
            f"The poses have {joints} joints; expected {skeleton.num_joints}, as in the skeleton."
        )
    vectors = np.asarray(_local_rotation_vectors(skeleton, stacked), float)
    broken = ~np.isfinite(vectors).all((1, 2))
    if broken.any():
        raise ValueError(f"Pose {int(np.argmax(broken))} is not finite; leave it out.")
    return vectors


def _poses_of_motions(poses: Poses) -> Pose:
    """Concatenate the poses of motions."""
    if isinstance(poses, Pose):
        return poses
    motions = [poses] if isinstance(poses, Motion) else list(poses)
    if not motions:
        raise ValueError("There are no motions to learn from; give at least one.")
    if len({motion.poses.rotations.shape[1] for motion in motions}) > 1:
        raise ValueError("The motions have different numbers of joints; give motions of one skeleton.")
    return concatenate_poses([motion.poses for motion in motions])
