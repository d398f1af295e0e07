"""The least-squares problems of an adaptation (Adaptation, eq. 4.3)."""

from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Shaped

from ..body.body import Body, pose_body
from ..body.limits.rotation_vector_boxes import PoseBoxes
from ..body.pose import Pose
from ..body.shape_modes import ShapeModes
from ..energy.data.pairs import PairDistances, PointPairs, num_pairs
from ..energy.energy import AbstractEnergy, sum_energies, weighted
from ..energy.stacked import NormalPrior, SmoothRotations, Stacked, weight_frames
from ..fit.problem import PoseProblem
from ..fit.sequences.problem import SequenceProblem
from ..fit.sequences.unknowns import ShapeCoefficients
from ..geometry.stacking import stack as stack_arrays

#: number of pairs that count as one independent measurement, as neighbouring pairs are correlated
PAIRS_PER_MEASUREMENT = 50.0
#: weight of a unit of log-likelihood against summed squared distances of pairs, metres squared; pairs deviate
#: by 3 mm
LIKELIHOOD_WEIGHT = 0.003**2 * PAIRS_PER_MEASUREMENT


class CoefficientPrior(eqx.Module):
    """A normal prior of the coefficients of modes."""

    #: mean, relative to the current coefficients
    mean: Float[Array, "K"]
    #: standard deviation of each coefficient
    deviation: Float[Array, "K"]


def pose_problem(
    body: Body,
    pairs: PointPairs,
    prior: AbstractEnergy,
    weight: float | Float[Array, ""],
    boxes: PoseBoxes | None = None,
    terms: AbstractEnergy | None = None,
) -> PoseProblem:
    """Build the problem of one frame's pose: `Q_data + weight Q_pose` and further terms.

    `Q_data` is the mean over the frame's pairs; `terms` are in units of a log-likelihood.
    """
    count = num_pairs(pairs)
    own = None if terms is None else weighted(LIKELIHOOD_WEIGHT / count, terms)
    data = weighted(1.0 / count, PairDistances(pairs))
    return PoseProblem(_sum(data, weighted(weight, prior), own), body, boxes)


def window_problem(
    body: Body,
    pairs: PointPairs,
    prior: AbstractEnergy,
    weight: float | Float[Array, ""],
    temporal: float | Float[Array, ""],
    times: Shaped[Array | np.ndarray, "F"],
    boxes: PoseBoxes | None = None,
    num_fixed: int = 0,
    terms: AbstractEnergy | None = None,
) -> SequenceProblem:
    """Build the problem of a window: the frames' mean of `Q_data + weight Q_pose`, plus `temporal Q_temp`.

    These are eqs. 4.3, 4.9 and 4.10. The poses of the first `num_fixed` frames are fixed.
    """
    frames, dtype = len(times), body.vertices.dtype
    shares = (1.0 / (frames * jax.vmap(num_pairs)(pairs))).astype(dtype)
    own = None if terms is None else weight_frames(LIKELIHOOD_WEIGHT * shares, terms)
    return SequenceProblem(
        body,
        _sum(weight_frames(shares, Stacked(PairDistances(pairs))), weighted(weight / frames, prior), own),
        jnp.asarray(times, dtype),
        between=(SmoothRotations(jnp.asarray(temporal / max(frames - 2, 1), dtype)),),
        boxes=boxes,
        fixed=jnp.arange(frames) < num_fixed,
    )


def shared_problem(
    body: Body,
    pairs: PointPairs,
    prior: AbstractEnergy,
    modes: ShapeModes,
    coefficient_prior: CoefficientPrior,
    mirrored: tuple[tuple[int, int], ...],
    weight: float | Float[Array, ""],
    deviation: float | Float[Array, ""],
    terms: AbstractEnergy | None = None,
) -> SequenceProblem:
    """Build the problem of several frames' poses and the coefficients of modes that they share.

    Paired bones have equal length (eq. 4.13 as a constraint).

    **Arguments:** `pairs` stacked over frames; `weight` of the pose prior relative to the mean squared
    distance of a pair, metres squared; `mirrored` pairs of joints, left and right; `deviation` of a pair's
    distance, metres, which scales the prior `coefficient_prior`; `terms` of every frame, in units of a log-likelihood.
    """
    dtype = body.vertices.dtype
    counts = jax.vmap(num_pairs)(pairs).astype(dtype)
    own = None if terms is None else weighted(LIKELIHOOD_WEIGHT, terms)
    frames = _sum(Stacked(PairDistances(pairs)), weight_frames(weight * counts, prior), own)
    spread = coefficient_prior.deviation / (deviation * PAIRS_PER_MEASUREMENT**0.5)
    return SequenceProblem(
        body,
        frames,
        jnp.arange(len(counts), dtype=dtype),
        {"modes": ShapeCoefficients(modes)},
        shared=(NormalPrior("modes", coefficient_prior.mean, spread),),
        mirrored=mirrored,
    )


def _sum(*energies: AbstractEnergy | None) -> AbstractEnergy:
    total = sum_energies(energies)
    assert total is not None
    return total


def stack(parts: Sequence):
    """Stack poses or pairs of single frames leaf by leaf."""
    return jax.tree.map(lambda *leaves: stack_arrays(leaves), *parts)


def stack_pairs(parts: Sequence[PointPairs]) -> PointPairs:
    """Stack pairs of single frames, padded with pairs of weight zero to equal numbers."""
    count = max(len(part.weights) for part in parts)

    def padded(part: PointPairs) -> PointPairs:
        extra = (0, count - len(part.weights))
        wide = jax.tree.map(
            lambda leaf: jnp.pad(leaf, (extra, *[(0, 0)] * (leaf.ndim - 1)), mode="edge"), part
        )
        return eqx.tree_at(lambda p: p.weights, wide, jnp.pad(part.weights, extra))

    return stack([padded(part) for part in parts])


def unstack(stacked, count: int) -> list:
    """Split stacked poses or pairs into those of single frames."""
    return [jax.tree.map(lambda leaf, i=i: leaf[i], stacked) for i in range(count)]


def mean_squared_distance(body: Body, pose: Pose, pairs: PointPairs) -> float:
    """Compute the mean weighted squared distance of a pair, metres squared."""
    return float(_mean_squared_distance(body, pose, pairs))


@eqx.filter_jit
def _mean_squared_distance(body: Body, pose: Pose, pairs: PointPairs) -> Float[Array, ""]:
    r = PairDistances(pairs).residual(pose_body(body, pose))
    return (r @ r) / num_pairs(pairs)
