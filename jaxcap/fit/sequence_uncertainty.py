"""How well the data hold the poses of a sequence and what its frames share: blocks of the covariance, and what nothing shows."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from ..arguments import checked
from ..body.skeleton import dof_layout
from .sequence_problem import SequenceEstimate, SequenceProblem
from .solve_sequence import SequenceSolution
from .solvers.block_banded import BlockBanded
from .solvers.cholesky import unit_scale
from .solvers.dense import Dense


class SequenceUncertainty(eqx.Module):
    """What the normal equations tell at a solution, by the tangents of poses and of what is shared."""

    #: covariance of each frame's pose, metres and radians squared
    poses: Float[Array, "F D D"]
    #: covariance of what is shared, in the order of the unknowns' names
    shared: Float[Array, "S S"]
    #: columns are directions of what is shared, on a unit diagonal
    directions: Float[Array, "S S"]
    #: which of these the energies do not hold
    unobservable: Bool[Array, "S"]
    #: which numbers of each frame's pose no energy holds
    still: Bool[Array, "F D"]
    names: tuple[str, ...] = eqx.field(static=True)


@checked
def sequence_uncertainty(
    problem: SequenceProblem,
    solution: SequenceSolution,
    variance: float | Float[Array, ""] | None = None,
    tolerance: float | None = None,
) -> SequenceUncertainty:
    """Compute the first-order uncertainty of a solved sequence: the blocks on the diagonal of `variance (J^T J)^-1`, without
    forming the rest of it.

    **Arguments:** `variance` is that of one component of the residual; where not given it is estimated as `|r|^2 / (R - N)`. A direction of
    what is shared counts as unobservable where its curvature, the poses being free, is below `tolerance` times the largest on a unit
    diagonal; where not given that is what rounding leaves of zero. Directions that are not observable have no part in the covariances of what
    is shared.
    """
    estimate = SequenceEstimate(solution.poses, solution.values)
    rows = jax.eval_shape(problem.residual, estimate).shape[0]
    frames, dofs, count = problem.num_frames, problem.body.skeleton.num_dofs, problem.num_shared
    if variance is None:
        variance = solution.energy / max(rows - frames * dofs - count, 1)
    dtype = problem.body.vertices.dtype
    if tolerance is None:
        tolerance = max(dofs * frames, 10) * float(jnp.finfo(dtype).eps)
    found = _blocks(problem, estimate, jnp.asarray(variance, dtype), jnp.asarray(tolerance, dtype))
    names = tuple(
        f"{name}[{number}]"
        for name in sorted(problem.unknowns)
        for number in range(problem.unknowns[name].size(problem.body))
    )
    return SequenceUncertainty(*found, names)


@eqx.filter_jit
def _blocks(problem: SequenceProblem, y: SequenceEstimate, variance, tolerance):
    arrow = problem.normal_equations(y)[2]
    still = arrow.frames.diagonal() <= tolerance * jnp.max(arrow.frames.diagonal(), 1, keepdims=True)
    # numbers that nothing holds are put aside, and have a variance of none
    held = ~still
    arrow = arrow.among((held, jnp.ones(len(arrow.shared), bool)))
    factor = arrow.frames.factorise()
    columns = factor.forward(arrow.coupling)
    schur = arrow.shared - jnp.tensordot(columns, columns, ((0, 1), (0, 1)), precision="highest")
    scale = unit_scale(jnp.diagonal(arrow.shared))
    values, directions = jnp.linalg.eigh(schur * scale[:, None] * scale)
    unobservable = values <= tolerance
    inverse = jnp.where(unobservable, 0.0, 1.0 / jnp.where(unobservable, 1.0, values))
    spread = scale[:, None] * directions
    shared = (spread * inverse) @ spread.T
    follow = factor.backward(columns)
    poses = _diagonal_inverse(arrow.frames, factor)
    poses = poses + jnp.einsum("fis,st,fjt->fij", follow, shared, follow, precision="highest")
    both = held[:, :, None] & held[:, None]
    return variance * jnp.where(both, poses, 0.0), variance * shared, directions, unobservable, still


def _diagonal_inverse(matrix: BlockBanded, factor) -> Float[Array, "F D D"]:
    """The blocks on the diagonal of the inverse."""
    frames, width, dofs, _ = matrix.blocks.shape
    one = jnp.eye(dofs, dtype=matrix.blocks.dtype)
    if width == 1:
        return jax.lax.map(lambda block: Dense(block).factorise().factor.solve(one), matrix.blocks[:, 0])

    def of_frame(frame):
        side = jnp.zeros((frames, dofs, dofs), one.dtype).at[frame].set(one)
        return factor.backward(factor.forward(side))[frame]

    return jax.lax.map(of_frame, jnp.arange(frames))


@checked
def describe_sequence(problem: SequenceProblem, result: SequenceUncertainty) -> list[str]:
    """Write a line for each direction of what is shared that nothing shows, and for each number of a pose that no energy
    holds, with the frames."""
    lines = []
    for column in np.flatnonzero(np.asarray(result.unobservable)):
        direction = np.asarray(result.directions[:, column])
        largest = np.argsort(-np.abs(direction))[:3]
        parts = [f"{direction[k]:+.2f} {result.names[k]}" for k in largest if abs(direction[k]) > 0.1]
        lines.append("The data do not show " + ", ".join(parts) + ".")
    still = np.asarray(result.still)
    for number, name in enumerate(dof_layout(problem.body.skeleton).names):
        frames = np.flatnonzero(still[:, number])
        if len(frames) == len(still):
            lines.append(f"The data do not show {name} in any frame.")
        elif len(frames):
            some = ", ".join(map(str, frames[:10])) + (" and others" if len(frames) > 10 else "")
            lines.append(f"The data do not show {name} in frames {some}.")
    return lines
