"""Uncertainty of the poses of a sequence and of its shared unknowns: blocks of the covariance, and
unobservable directions.
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Bool, Float

from ...arguments import checked
from ...body.skeleton import dof_layout
from ...errors import InputError
from ...value_checks import check_positive
from ..linear_solvers.cholesky import diagonal_scale
from ..solvers.implicit import free_unknowns
from .poses_and_shared import AbstractPosesAndShared, PosesAndSharedSolution

#: a coordinate is unobservable if its variance, on a unit diagonal, is above this share of the largest
#: resolvable one
MAX_VARIANCE_SHARE = 0.02


class SequenceUncertainty(eqx.Module):
    """First-order uncertainty from the normal equations at a solution, in tangents of poses and of shared
    unknowns.

    An unobservable coordinate has an infinite variance, and its covariances are NaN. A fixed coordinate, or
    one pressed against a bound, has a variance of zero.
    """

    #: covariance of each frame's pose, metres and radians squared
    poses: Float[Array, "F D D"]
    #: covariance of the shared unknowns, in the order of their names
    shared: Float[Array, "S S"]
    #: columns are directions of the shared unknowns, on a unit diagonal
    directions: Float[Array, "S S"]
    #: mask of those that the energies do not determine
    unobservable: Bool[Array, "S"]
    #: mask of the coordinates of each frame's pose that no energy determines
    unobservable_poses: Bool[Array, "F D"]
    #: true if the solution had converged; otherwise the results hold only nearby
    trustworthy: Bool[Array, ""]
    names: tuple[str, ...] = eqx.field(static=True)


@checked
def sequence_uncertainty(
    problem: AbstractPosesAndShared,
    solution: PosesAndSharedSolution,
    variance: float | Float[Array, ""] | None = None,
    tolerance: float | None = None,
) -> SequenceUncertainty:
    """Compute the first-order uncertainty of the poses of all frames and of what they share, within the
    problem's bounds and equalities.

    These are the diagonal blocks of `variance (J^T J)^-1`; the rest of it is not formed.

    **Arguments:** a `SequenceProblem` with the solution of `solve_sequence`, a `CalibrationProblem` with that of
    `solve_calibration`, or a `JointProblem` with that of `solve_joints`. `variance` is that of one component of
    the residual; where not given it is estimated as `|r|^2 / (R - N)`. It is one in a calibration, whose residuals
    are in standard deviations; there the covariance of what is shared is also multiplied by the number of
    frames that count as one observation. Learned joints assume errors of vertices with the inverse of the
    metric as covariance, smooth over the surface as those of registrations are; for independent errors and a
    large `alpha` the deviations are too large. A direction of the shared unknowns counts as unobservable where
    its curvature, with free poses, is below `tolerance` times the largest on a unit diagonal; where not given
    that is the rounding error of zero. Coordinates with a part in such a direction have an infinite variance.

    **Raises:** `InputError` for a solution with an energy that is not finite, and for a variance that is not above 0.
    """
    if not isinstance(solution.energy, Tracer) and not np.isfinite(solution.energy):
        raise InputError(
            "sequence_uncertainty: the solution's energy is not finite; check the data for NaN, and the `result` "
            "of the solution."
        )
    check_positive("sequence_uncertainty", variance=variance)
    skeleton = problem.skeleton_of_poses()
    if variance is None:
        variance = problem.residual_variance(solution.estimate, solution.energy)
    dtype = skeleton.centres.dtype
    if tolerance is None:
        tolerance = max(skeleton.num_dofs, 10) * float(jnp.finfo(dtype).eps)
    found = _covariance_blocks(
        problem, solution.estimate, jnp.asarray(variance, dtype), jnp.asarray(tolerance, dtype)
    )
    return SequenceUncertainty(*found, solution.trustworthy, problem.shared_names())


@eqx.filter_jit
@jax.default_matmul_precision("highest")
def _covariance_blocks(problem: AbstractPosesAndShared, y: Any, variance, tolerance):
    info = problem.information_of_data(y)
    arrow: Any = info.hessian
    units = problem.scales()
    free = free_unknowns(info)
    arrow = arrow.restricted(free)
    # on a unit diagonal, undetermined coordinates get the smallest resolvable curvature
    x, s = (jax.lax.stop_gradient(unit_diagonal_scale(part, tolerance)) for part in arrow.diagonal())

    arrow = arrow.rescaled(x, s)
    arrow = arrow.add_diagonal((jnp.full_like(x, tolerance), jnp.zeros_like(s)))
    factor = arrow.frames.factorise()
    columns = factor.forward(arrow.coupling)
    schur = arrow.shared - jnp.tensordot(columns, columns, ((0, 1), (0, 1)), precision="highest")
    kept = None if info.constraints is None else info.constraints.equalities
    rows = jnp.zeros((0, len(s)), s.dtype) if kept is None else kept.rows * s
    values, directions, fixed = _constrained_eigh(*jax.lax.stop_gradient((schur, rows)))

    unobservable = (values <= tolerance) & ~fixed
    inverse = jnp.where(fixed, 0.0, 1.0 / jnp.maximum(values, tolerance))
    shared = jnp.einsum("ik,k,jk->ij", directions, inverse, directions, precision="highest")
    shared = differentiable_inverse(schur, shared)
    follow, inflation = factor.backward(columns), problem.variance_inflation()
    poses = factor.inverse_diagonal_blocks() + inflation * jnp.einsum(
        "fis,st,fjt->fij", follow, shared, follow, precision="highest"
    )
    poses, still = mask_unobservable(poses, free[0], tolerance)
    shared, _ = mask_unobservable(shared, free[1], tolerance)
    poses = variance * poses * outer(x * units[0])
    turn = problem.pose_bases(y)
    if turn is not None:
        poses = jnp.einsum("fai,fij,fbj->fab", turn, poses, turn, precision="highest")
    return poses, inflation * variance * shared * outer(s * units[1]), directions, unobservable, still


def unit_diagonal_scale(diagonal: Float[Array, "*S"], tolerance) -> Float[Array, "*S"]:
    """Compute the scale to a unit diagonal, except for curvatures below the rounding error of the largest."""
    largest = jnp.max(diagonal, initial=0.0)
    return diagonal_scale(jnp.where(diagonal > tolerance**2 * largest, diagonal, largest))


def _constrained_eigh(matrix: Float[Array, "S S"], rows: Float[Array, "C S"]):
    """Find curvatures and directions of a matrix in the null space of equalities; the directions fixed by
    them are marked.
    """
    size = matrix.shape[0]
    if len(rows) == 0:
        return *jnp.linalg.eigh(matrix), jnp.zeros(size, bool)
    _, lengths, across = jnp.linalg.svd(rows, full_matrices=False)
    across = jnp.where((lengths > size * jnp.finfo(lengths.dtype).eps * lengths[0])[:, None], across, 0.0)
    fixing = across.T @ across
    project = jnp.eye(size, dtype=matrix.dtype) - fixing
    # larger than any curvature on a unit diagonal
    beyond = 4.0 * size
    values, directions = jnp.linalg.eigh(project @ matrix @ project + beyond * fixing)
    return values, directions, values > beyond / 2


def mask_unobservable(covariance: Float[Array, "*F N N"], free: Bool[Array, "*F N"], tolerance):
    """Set infinite variances for unobservable coordinates, and zero for those that are not free."""
    variances = jnp.diagonal(covariance, axis1=-2, axis2=-1)
    unseen = free & (variances > MAX_VARIANCE_SHARE / tolerance)
    eye = jnp.eye(free.shape[-1], dtype=bool)
    either = unseen[..., :, None] | unseen[..., None, :]
    covariance = jnp.where(either, jnp.where(eye, jnp.inf, jnp.nan), covariance)
    return jnp.where(free[..., :, None] & free[..., None, :], covariance, 0.0), unseen


@jax.custom_jvp
def differentiable_inverse(matrix: Float[Array, "N N"], inverse: Float[Array, "N N"]) -> Float[Array, "N N"]:
    """Return the known inverse of a matrix, on its range, with the derivative of an inverse.

    Unlike the eigenvectors that it is made of, an inverse has derivatives where curvatures are equal.
    """
    return inverse


@differentiable_inverse.defjvp
def _differentiate_inverse(primals, tangents):
    inverse = differentiable_inverse(*primals)
    return inverse, -inverse @ tangents[0] @ inverse


def outer(scale: Float[Array, "*F N"]) -> Float[Array, "*F N N"]:
    return scale[..., :, None] * scale[..., None, :]


@checked
def describe_sequence(problem: AbstractPosesAndShared, result: SequenceUncertainty) -> list[str]:
    """Describe the unobservable parts of a solution, a line each.

    A line for each unobservable direction of the shared unknowns, for each coordinate of a pose that no
    energy determines, with the frames, and for a solution that had not converged.
    """
    lines = []
    if not result.trustworthy:
        lines.append("The solver did not converge; deviations are valid only at a minimum.")
    for column in np.flatnonzero(np.asarray(result.unobservable)):
        direction = np.asarray(result.directions[:, column])
        largest = np.argsort(-np.abs(direction))[:3]
        parts = [f"{direction[k]:+.2f} {result.names[k]}" for k in largest if abs(direction[k]) > 0.1]
        lines.append("The data do not determine " + ", ".join(parts) + ".")
    still = np.asarray(result.unobservable_poses)
    for number, name in enumerate(dof_layout(problem.skeleton_of_poses()).names):
        frames = np.flatnonzero(still[:, number])
        if len(frames) == len(still):
            lines.append(f"The data do not determine {name} in any frame.")
        elif len(frames):
            some = ", ".join(map(str, frames[:10])) + (" and others" if len(frames) > 10 else "")
            lines.append(f"The data do not determine {name} in frames {some}.")
    return lines
