"""Move points of a retargeted body to the positions of the source's, at its own size: hands together, feet on
the floor."""

from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...arguments import checked
from ...body.body import Body, pose_body
from ...body.pose import Motion, Pose
from ...body.skeleton import Skeleton
from ...body.skin import RigidSkin
from ...energy.data.landmarks import VertexLandmarks
from ...energy.priors.reference_pose import PosePrior, tangent_deviations
from ...fit.solve import solve
from ..ik.constraints import Constraint, Constraints, constrained_body, make_constraints
from .retarget import UP

#: standard deviations of a pair of weight one, metres, and of the pose from its initial value, metres and
#: radians
PAIR_DEVIATION, TRANSLATION_DEVIATION, ROTATION_DEVIATION = 0.001, 0.05, 0.2


class PointPair(NamedTuple):
    """A point of the source and one of the target: a vertex by its number, or a joint by its name."""

    source: int | str
    target: int | str
    #: relative weight, above 0
    weight: float = 1.0


class PointPairResult(NamedTuple):
    """A motion, and the remaining distances of its points from their targets."""

    motion: Motion
    #: (F, K) distance of each pair, metres
    distances: Float[np.ndarray, "F K"]


@checked
def match_points(
    motion: Motion,
    source: Body | Skeleton,
    target: Body | Skeleton,
    retargeted: Motion,
    pairs: Sequence[PointPair],
    *,
    ratio: float = 1.0,
    floor: float = 0.0,
    up: Float[np.ndarray, "3"] = UP,
) -> PointPairResult:
    """Adjust the retargeted motion `retargeted` so that points of the target reach those of the source's `motion`.

    The motion `retargeted` of the target, from `retarget`, is changed as little as possible. Every frame is solved
    separately from its own pose, to which a `PosePrior` pulls it; unconstrained degrees of freedom stay
    unchanged.

    **Arguments:** `ratio` is the size ratio of target to source, about the origin and the `floor`, metres
    along `up`. With 1, points reach the same world positions, as for contacts with objects; `size_ratio`
    scales them to the target's size. A joint or vertex of several pairs gets the mean of its target
    positions, by their weights.

    **Raises:** `ValueError` if there are no pairs, a body does not have a point, vertices are named of a
    skeleton without a surface, motions have unequal lengths, or a weight is not a number above 0.
    """
    if not pairs:
        raise ValueError("There are no point pairs; give at least one.")
    if len(retargeted) != len(motion):
        raise ValueError(
            f"The retargeted motion has {len(retargeted)} frames, and its source {len(motion)}; give two motions of the "
            "same length."
        )
    if not 0 < ratio < np.inf:
        raise ValueError(f"The size ratio is {ratio:g}; expected above 0.")
    for pair in pairs:
        if not 0 < pair.weight < np.inf:
            raise ValueError(
                f"The weight of the pair {pair.source} and {pair.target} is {pair.weight:g}; expected above 0."
            )
    here = _PointSet(target, [pair.target for pair in pairs], "target")
    there = _PointSet(source, [pair.source for pair in pairs], "source")
    scaled = ratio * there.positions(motion.poses)[:, there.rows] + (1.0 - ratio) * floor * up
    targets, weights = here.mean_targets(scaled, [pair.weight for pair in pairs])
    dtype = retargeted.poses.translations.dtype
    poses = _solve_frames(
        here.body,
        here.constraints,
        retargeted.poses,
        jnp.asarray(targets, dtype),
        jnp.asarray(weights / PAIR_DEVIATION**2, dtype),
    )
    reached = here.positions(poses)[:, here.rows]
    return PointPairResult(Motion(poses, retargeted.rate), np.linalg.norm(reached - scaled, axis=-1))


class _PointSet:
    """Some points of a body or a skeleton, without duplicates, as `Constraints`."""

    def __init__(self, owner: Body | Skeleton, points: Sequence[int | str], which: str):
        _check_points(owner, points, which)
        self.body = owner if isinstance(owner, Body) else _skeleton_body(owner)
        # vertices come first in `Constraints`
        order = sorted(dict.fromkeys(points), key=lambda point: isinstance(point, str))
        #: row of each of `points`
        self.rows = np.array([order.index(point) for point in points])
        self.constraints = make_constraints(
            self.body, [Constraint(point, (0.0, 0.0, 0.0)) for point in order]
        )

    def positions(self, poses: Pose) -> Float[np.ndarray, "F C 3"]:
        return np.asarray(_point_positions(self.body, self.constraints, poses), float)

    def mean_targets(
        self, positions: Float[np.ndarray, "F K 3"], weights: Sequence[float]
    ) -> tuple[Float[np.ndarray, "F C 3"], Float[np.ndarray, "C"]]:
        """Average the targets of pairs that share a point; return position and weight of every row."""
        shares = np.zeros((len(self.constraints.weights), len(self.rows)))
        shares[self.rows, np.arange(len(self.rows))] = weights
        total = shares.sum(1)
        shares /= np.where(total > 0, total, 1.0)[:, None]
        return np.einsum("ck,fka->fca", shares, positions), total


def _check_points(owner: Body | Skeleton, points: Sequence[int | str], which: str) -> None:
    skeleton = owner if isinstance(owner, Skeleton) else owner.skeleton
    for point in points:
        if isinstance(point, str):
            if point not in skeleton.names:
                raise ValueError(
                    f"There is no joint '{point}' in the {which}, which has {', '.join(skeleton.names)}."
                )
        elif isinstance(owner, Skeleton):
            raise ValueError(
                f"Vertex {point} is given for the {which}, which is a skeleton without a surface; name a joint."
            )
        elif not 0 <= point < len(owner.vertices):
            raise ValueError(
                f"There is no vertex {point} in the {which}, which has {len(owner.vertices)} vertices; give one from 0 "
                f"to {len(owner.vertices) - 1}."
            )


def _skeleton_body(skeleton: Skeleton) -> Body:
    """Make a body with a vertex at each joint, as point arrays refer to a body's vertices."""
    centres = skeleton.centres
    return Body(skeleton, RigidSkin(jnp.arange(len(centres))), centres, jnp.zeros((0, 3), int))


@eqx.filter_jit
def _point_positions(body: Body, constraints: Constraints, poses: Pose) -> Float[Array, "F C 3"]:
    small = constrained_body(body, constraints)
    return jax.lax.map(lambda pose: pose_body(small, pose).vertices, poses)


@eqx.filter_jit
def _solve_frames(
    body: Body,
    constraints: Constraints,
    poses: Pose,
    targets: Float[Array, "F C 3"],
    weights: Float[Array, "C"],
) -> Pose:
    small, points = constrained_body(body, constraints), jnp.arange(len(weights))
    deviations = tangent_deviations(body.skeleton, TRANSLATION_DEVIATION, ROTATION_DEVIATION)

    def one(frame):
        pose, landmarks = frame
        energy = VertexLandmarks(points, landmarks, weights) + PosePrior(pose, deviations)
        return solve(energy, small, pose).pose

    return jax.lax.map(one, (poses, targets))
