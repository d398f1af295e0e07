"""The objective of an adaptation: its terms, and its least-squares problems (Adaptation, 4.1.3)."""

from collections.abc import Collection, Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Shaped

from ..arguments import checked
from ..body.body import Body, pose_body
from ..body.pose import Motion, Pose
from ..body.shape_modes import ShapeModes
from ..body.skeleton import Skeleton
from ..body.symmetry import length_differences
from ..energy.data.pairs import PairDistances, PointPairs, num_pairs
from ..energy.energy import AbstractEnergy, sum_energies, weighted
from ..energy.priors.temporal import second_difference
from ..energy.stacked import NormalPrior, SmoothRotations, Stacked, weight_frames
from ..fit.pose_problem import PoseProblem
from ..fit.sequences.sequence_problem import SequenceProblem
from ..fit.sequences.unknowns import ShapeCoefficients
from ..limits.rotation_vector_boxes import PoseBoxes

#: number of pairs that count as one independent measurement, as neighbouring pairs are correlated
PAIRS_PER_MEASUREMENT = 50.0
#: weight of a unit of log-likelihood against summed squared distances of pairs, metres squared; pairs deviate
#: by 3 mm
LIKELIHOOD_WEIGHT = 0.003**2 * PAIRS_PER_MEASUREMENT


class PoseTerms(eqx.Module):
    """The terms of a pose's objective in addition to its pairs."""

    prior: AbstractEnergy
    #: weight of the prior relative to the mean squared distance of a pair, metres squared
    weight: float | Float[Array, ""] = 1e-6
    #: hard limits of joint rotations
    boxes: PoseBoxes | None = None
    #: further energies, in units of a log-likelihood
    user: AbstractEnergy | None = None


class CoefficientPrior(eqx.Module):
    """A normal prior of the coefficients of modes."""

    #: mean, relative to the current coefficients
    mean: Float[Array, "K"]
    #: standard deviation of each coefficient
    deviation: Float[Array, "K"]


def pose_problem(body: Body, pairs: PointPairs, terms: PoseTerms) -> PoseProblem:
    """Build the problem of one frame's pose: `Q_data + weight Q_pose` and the user's terms.

    `Q_data` is the mean over the frame's pairs.
    """
    count = num_pairs(pairs)
    user = None if terms.user is None else weighted(LIKELIHOOD_WEIGHT / count, terms.user)
    data = weighted(1.0 / count, PairDistances(pairs))
    return PoseProblem(_sum(data, weighted(terms.weight, terms.prior), user), body, terms.boxes)


@checked
def window_problem(
    body: Body,
    pairs: PointPairs,
    terms: PoseTerms,
    temporal_weight: float | Float[Array, ""],
    times: Shaped[Array | np.ndarray, "F"],
    num_fixed: int = 0,
) -> SequenceProblem:
    """Build the problem of a window: the frames' mean of `Q_data + weight Q_pose`, plus `temporal_weight Q_temp`.

    These are eqs. 4.3, 4.9 and 4.10. The poses of the first `num_fixed` frames are fixed.
    """
    frames, dtype = len(times), body.vertices.dtype
    shares = (1.0 / (frames * jax.vmap(num_pairs)(pairs))).astype(dtype)
    user = None if terms.user is None else weight_frames(LIKELIHOOD_WEIGHT * shares, terms.user)
    data, prior = Stacked(PairDistances(pairs)), weighted(terms.weight / frames, terms.prior)
    return SequenceProblem(
        body,
        _sum(weight_frames(shares, data), prior, user),
        jnp.asarray(times, dtype),
        between=(SmoothRotations(jnp.asarray(temporal_weight / max(frames - 2, 1), dtype)),),
        boxes=terms.boxes,
        fixed=jnp.arange(frames) < num_fixed,
    )


@checked
def shared_problem(
    body: Body,
    pairs: PointPairs,
    terms: PoseTerms,
    modes: ShapeModes,
    coefficient_prior: CoefficientPrior,
    left_right_pairs: tuple[tuple[int, int], ...],
    deviation: float | Float[Array, ""],
) -> SequenceProblem:
    """Build the problem of several frames' poses and the coefficients of modes that they share.

    Paired bones have equal length (eq. 4.13 as a constraint).

    **Arguments:** `pairs` stacked over frames; `terms` of every frame, whose limits have no effect; `left_right_pairs`
    pairs of joints, left and right; `deviation` of a pair's distance, metres, which scales the prior
    `coefficient_prior`.
    """
    dtype = body.vertices.dtype
    counts = jax.vmap(num_pairs)(pairs).astype(dtype)
    user = None if terms.user is None else weighted(LIKELIHOOD_WEIGHT, terms.user)
    frames = _sum(Stacked(PairDistances(pairs)), weight_frames(terms.weight * counts, terms.prior), user)
    spread = coefficient_prior.deviation / (deviation * PAIRS_PER_MEASUREMENT**0.5)
    return SequenceProblem(
        body,
        frames,
        jnp.arange(len(counts), dtype=dtype),
        {"modes": ShapeCoefficients(modes)},
        shared=(NormalPrior("modes", coefficient_prior.mean, spread),),
        left_right_pairs=left_right_pairs,
    )


def _sum(*energies: AbstractEnergy | None) -> AbstractEnergy:
    total = sum_energies(energies)
    assert total is not None
    return total


class Terms(NamedTuple):
    """The value of each term."""

    #: mean weighted squared distance of a pair (eq. 4.4), metres squared
    data: float
    #: mean of the pose prior over frames (eq. 4.7)
    pose: float
    #: mean squared second difference of rotation vectors (eq. 4.9), radians squared
    temporal: float
    #: mean squared change of the Laplacian vectors (eq. 4.11), metres squared
    shape: float
    #: summed squared differences of paired bones' lengths (eq. 4.13), metres squared
    symmetry: float
    #: mean over frames of the user's energies, in units of a log-likelihood
    user: float = 0.0


def mean_squared_distance(body: Body, pose: Pose, pairs: PointPairs) -> float:
    """Compute the mean weighted squared distance of a pair, metres squared."""
    return float(_mean_squared_distance(body, pose, pairs))


@eqx.filter_jit
def _mean_squared_distance(body: Body, pose: Pose, pairs: PointPairs) -> Float[Array, ""]:
    r = PairDistances(pairs).residual(pose_body(body, pose))
    return (r @ r) / num_pairs(pairs)


def pose_energy(prior: AbstractEnergy, body: Body, poses: Pose) -> float:
    """Compute the mean energy of a prior over stacked poses."""
    return float(_pose_energy(prior, body, poses))


def symmetry_energy(skeleton: Skeleton, left_right_pairs: Sequence[tuple[int, int]]) -> float:
    """Sum the squared differences of paired bones' lengths (eq. 4.13)."""
    return float(_symmetry_energy(skeleton, tuple(left_right_pairs)))


@eqx.filter_jit
def _symmetry_energy(skeleton: Skeleton, left_right_pairs: tuple[tuple[int, int], ...]) -> Float[Array, ""]:
    differences, _ = length_differences(skeleton, left_right_pairs)
    return jnp.sum(differences**2)


def motion_energy(skeleton: Skeleton, motion: Motion, excluded: Collection[int] = ()) -> float:
    """Compute the temporal energy of a motion (eq. 4.9); zero for fewer than three frames.

    The frames `excluded` are excluded if at least three others are left; else all are used.
    """
    every = np.arange(len(motion))
    frames = np.setdiff1d(every, list(excluded))
    frames = frames if len(frames) > 2 else every
    poses = jax.tree.map(lambda leaf: leaf[frames], motion.poses)
    since = jnp.asarray(np.diff(frames), float)
    return float(temporal_energy(skeleton, poses, since)) if len(frames) > 2 else 0.0


def balancing_weight(data: float, term: float) -> float:
    """Compute the weight that balances a term with the data (eqs. 4.15, 4.16); zero for a zero term."""
    return data / term if term > 1e-12 else 0.0


@eqx.filter_jit
def temporal_energy(
    skeleton: Skeleton, poses: Pose, intervals: Float[Array, "G"] | None = None
) -> Float[Array, ""]:
    """Compute `Q_temp` (eqs. 4.9 and 4.10), radians squared.

    It is the mean over inner frames and joints of the squared difference of a rotation vector from the mean
    of its neighbours in time. `intervals` is the number of frames from each pose to the next, one by default.
    """
    q = poses.rotations
    intervals = jnp.ones(len(q) - 1) if intervals is None else intervals
    differences = second_difference(q[:-2], q[1:-1], q[2:], intervals[:-1], intervals[1:])
    return jnp.sum(differences**2) / (differences.shape[0] * differences.shape[1])


@eqx.filter_jit
def _pose_energy(prior: AbstractEnergy, body: Body, poses: Pose) -> Float[Array, ""]:
    def of_frame(pose):
        residual = prior.residual(pose_body(body, pose))
        return residual @ residual

    return jnp.mean(jax.lax.map(of_frame, poses))
