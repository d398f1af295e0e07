"""What the poses of an adaptation minimise, as energies and problems (Adaptation, eq. 4.3)."""

from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Shaped

from ..body.body import Body, pose_body
from ..body.pose import Pose
from ..body.pose_boxes import PoseBoxes
from ..body.shape_modes import Modes
from ..energy.pairs import PairDistances, Pairs, num_pairs
from ..energy.stacked import NormalPrior, SmoothTurns, Stacked, weigh_frames
from ..energy.term import AbstractEnergy, Sum, weighted
from ..fit.problem import PoseProblem
from ..fit.sequence_problem import SequenceProblem
from ..fit.unknowns import ShapeCoefficients
from ..geometry.stacking import stack as stack_arrays

#: pairs that are neighbours say the same: so many count as one
ALIKE = 50.0


class Belief(eqx.Module):
    """Where the amounts of the modes are, before any pair is looked at."""

    #: from where they stand
    expected: Float[Array, "K"]
    #: standard deviation of each
    deviation: Float[Array, "K"]


def pose_problem(
    body: Body, pairs: Pairs, prior: AbstractEnergy, weight: float | Float[Array, ""], boxes: PoseBoxes | None
) -> PoseProblem:
    """`Q_data + weight Q_pose` of a frame, with `Q_data` the mean over its pairs."""
    data = weighted(1.0 / num_pairs(pairs), PairDistances(pairs))
    return PoseProblem(Sum((data, *_terms(weighted(weight, prior)))), body, boxes)


def window_problem(
    body: Body,
    pairs: Pairs,
    prior: AbstractEnergy,
    weight: float | Float[Array, ""],
    temporal: float | Float[Array, ""],
    times: Shaped[Array | np.ndarray, "F"],
    boxes: PoseBoxes | None = None,
    held: int = 0,
) -> SequenceProblem:
    """The mean over frames of `Q_data + weight Q_pose`, and `temporal Q_temp` (eqs. 4.3, 4.9 and 4.10); the first `held`
    frames keep their poses."""
    frames, dtype = len(times), body.vertices.dtype
    counts = jax.vmap(num_pairs)(pairs)
    data = weigh_frames((1.0 / (frames * counts)).astype(dtype), Stacked(PairDistances(pairs)))
    return SequenceProblem(
        body,
        Sum((data, *_terms(weighted(weight / frames, prior)))),
        jnp.asarray(times, dtype),
        between=(SmoothTurns(jnp.asarray(temporal / max(frames - 2, 1), dtype)),),
        boxes=boxes,
        held=jnp.arange(frames) < held,
    )


def shared_problem(
    body: Body,
    pairs: Pairs,
    prior: AbstractEnergy,
    modes: Modes,
    belief: Belief,
    mirrored: tuple[tuple[int, int], ...],
    weight: float | Float[Array, ""],
    deviation: float | Float[Array, ""],
) -> SequenceProblem:
    """Poses of several frames and the amounts of modes that they share. Paired bones are equally long (eq. 4.13 as a constraint).

    **Arguments:** `pairs` stacked over frames; `weight` of the pose prior against the mean squared distance
    of a pair, metres squared; `mirrored` pairs of joints of the left and the right; `deviation` of a pair's
    distance, metres, against which beliefs count.
    """
    dtype = body.vertices.dtype
    counts = jax.vmap(num_pairs)(pairs).astype(dtype)
    frames = Sum((Stacked(PairDistances(pairs)), *_terms(weigh_frames(weight * counts, prior))))
    spread = belief.deviation / (deviation * ALIKE**0.5)
    return SequenceProblem(
        body,
        frames,
        jnp.arange(len(counts), dtype=dtype),
        {"modes": ShapeCoefficients(modes)},
        shared=(NormalPrior("modes", belief.expected, spread),),
        mirrored=mirrored,
    )


def _terms(energy: AbstractEnergy) -> tuple[AbstractEnergy, ...]:
    return energy.terms if isinstance(energy, Sum) else (energy,)


def stack(parts: Sequence):
    """Poses or pairs of single frames as those of all, leaf by leaf."""
    return jax.tree.map(lambda *leaves: stack_arrays(leaves), *parts)


def stack_pairs(parts: Sequence[Pairs]) -> Pairs:
    """Pairs of single frames as those of all; scans of fewer points get pairs of weight zero."""
    count = max(len(part.weights) for part in parts)

    def padded(part: Pairs) -> Pairs:
        extra = (0, count - len(part.weights))
        wide = jax.tree.map(
            lambda leaf: jnp.pad(leaf, (extra, *[(0, 0)] * (leaf.ndim - 1)), mode="edge"), part
        )
        return eqx.tree_at(lambda p: p.weights, wide, jnp.pad(part.weights, extra))

    return stack([padded(part) for part in parts])


def unstack(whole, count: int) -> list:
    """What `stack` made one of, frame by frame."""
    return [jax.tree.map(lambda leaf, i=i: leaf[i], whole) for i in range(count)]


def mean_square(body: Body, pose: Pose, pairs: Pairs) -> float:
    """The mean weighed squared distance of a pair, metres squared."""
    return float(_mean_square(body, pose, pairs))


@eqx.filter_jit
def _mean_square(body: Body, pose: Pose, pairs: Pairs) -> Float[Array, ""]:
    r = PairDistances(pairs).residual(pose_body(body, pose))
    return (r @ r) / num_pairs(pairs)
