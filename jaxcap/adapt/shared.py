"""What all frames share, a body's rest by some modes, with the poses of them all (Adaptation, 4.1.4)."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..body.body import Body
from ..body.pose import Pose, retract
from ..body.shape_modes import Modes, bone_differences, moved
from ..energy.term import AbstractEnergy
from ..fit.correspond import Pairs
from ..fit.solvers.block_arrow import BlockArrow
from ..fit.solvers.block_banded import BlockBanded
from ..fit.solvers.equalities import Equalities
from .equations import num_pairs, shared_equations, with_prior

#: pairs that are neighbours say the same: so many count as one
ALIKE = 50.0


class Belief(eqx.Module):
    """Where the amounts of the modes are, before any pair is looked at."""

    #: from where they stand
    expected: Float[Array, "K"]
    #: standard deviation of each
    deviation: Float[Array, "K"]


@eqx.filter_jit
def adapt_shared(
    body: Body,
    poses: Pose,
    pairs: Pairs,
    prior: AbstractEnergy,
    modes: Modes,
    belief: Belief,
    mirrored: tuple[tuple[int, int], ...],
    weight: Float[Array, ""],
    deviation: Float[Array, ""],
) -> tuple[Body, Pose, Float[Array, "K"]]:
    """One Gauss-Newton step on all poses and the amounts of the modes that they share, a block-arrow; paired
    bones end equally long (eq. 4.13 as a constraint).

    **Arguments:** `poses` and `pairs` stacked over frames; `weight` of the pose prior against the mean squared distance
    of a pair, metres squared; `mirrored` pairs of joints of the left and the right; `deviation` of a pair's
    distance, metres, against which beliefs count.

    Returns the body, the poses, and by how much the body has gone along each mode.
    """
    skeleton, dofs = body.skeleton, body.skeleton.num_dofs

    def of_frame(frame):
        pose, pairs = frame
        matrix, side, _ = shared_equations(body, pose, pairs, modes)
        # a prior counts as it does for a pose by itself, against the mean of the pairs
        scale = weight * num_pairs(pairs)
        own, own_side = with_prior(matrix[:dofs, :dofs], side[:dofs], body, pose, prior, scale)
        return own, matrix[:dofs, dofs:], matrix[dofs:, dofs:], own_side, side[dofs:]

    frames, coupling, shared, frame_sides, shared_sides = jax.lax.map(of_frame, (poses, pairs))
    own = BlockBanded(frames[:, None])
    diagonal = own.diagonal()
    own = own.add_diagonal(1e-3 * diagonal + 1e-6 * jnp.max(diagonal, 1, keepdims=True))
    hold = ALIKE * (deviation / belief.deviation) ** 2
    arrow = BlockArrow(own, coupling, jnp.sum(shared, 0) + jnp.diag(hold))
    side = frame_sides, jnp.sum(shared_sides, 0) + hold * belief.expected
    differences, rows = bone_differences(body, modes, mirrored)
    by_frame, amounts = arrow.factorise().solve(side, Equalities(rows, -differences))
    poses = jax.vmap(retract, (None, 0, 0))(skeleton, poses, by_frame)
    return moved(body, modes, amounts), poses, amounts
