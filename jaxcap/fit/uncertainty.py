"""Uncertainty of a solution: covariance, and unobservable directions."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from ..arguments import checked
from ..body.body import Body
from ..body.pose import Pose
from ..body.skeleton import Skeleton, dof_layout
from ..energy.check_energies import check_energy_arrays, explain_errors
from ..energy.energy import AbstractEnergy
from ..value_checks import check_positive
from .pose_problem import PoseProblem
from .sequences.uncertainty import differentiable_inverse, mask_unobservable, outer, unit_diagonal_scale


class Uncertainty(eqx.Module):
    """First-order uncertainty from the normal matrix `J^T J` at a solution, in tangents of `retract`."""

    #: metres and radians squared; an unobservable component has an infinite variance, and its covariances are NaN
    covariance: Float[Array, "D D"]
    #: eigenvalues of `J^T J` on a unit diagonal, rising
    curvatures: Float[Array, "D"]
    #: columns are orthonormal directions in tangent space, in scaled units; the first ones span those of the first curvatures
    directions: Float[Array, "D D"]
    #: mask of the directions that the energy does not determine
    unobservable: Bool[Array, "D"]


@checked
def uncertainty(
    energy: AbstractEnergy,
    body: Body,
    pose: Pose,
    variance: float | Float[Array, ""] | None = None,
    tolerance: float | None = None,
) -> Uncertainty:
    """Compute the first-order uncertainty of a solved pose.

    **Arguments:** `variance` is that of one component of the residual; where not given it is estimated as
    `|r|^2 / (R - D)`. A direction counts as unobservable where its curvature, on a unit diagonal, is below
    `tolerance` times the largest; where not given that is D times the machine's precision, the rounding error of a
    curvature of zero.

    The covariance has derivatives; curvatures and directions count as constants.
    """
    check_positive("uncertainty", variance=variance)
    check_energy_arrays(energy, body)
    problem = PoseProblem(energy, body)
    with explain_errors(energy, body, pose):
        residual, jacobian = problem.linearise(pose)
    scales = problem.scales()
    if variance is None:
        variance = residual @ residual / max(residual.shape[0] - scales.shape[0], 1)
    if tolerance is None:
        tolerance = scales.shape[0] * float(jnp.finfo(residual.dtype).eps)
    return Uncertainty(*_covariance(jacobian, scales, variance, tolerance))


@eqx.filter_jit
@jax.default_matmul_precision("highest")
def _covariance(jacobian: Float[Array, "R D"], scales: Float[Array, "D"], variance, tolerance):
    matrix = (jacobian * scales).T @ (jacobian * scales)
    # precise and vague information have curvatures that differ by more than the precision
    unit = jax.lax.stop_gradient(unit_diagonal_scale(jnp.diagonal(matrix), tolerance))
    matrix = matrix * outer(unit)
    curvatures, directions = jnp.linalg.eigh(jax.lax.stop_gradient(matrix))
    unobservable = curvatures <= tolerance * curvatures[-1]
    inverse = 1.0 / jnp.where(unobservable, tolerance, curvatures)
    covariance = differentiable_inverse(matrix, (directions * inverse) @ directions.T)

    covariance, _ = mask_unobservable(covariance, jnp.ones(len(scales), bool), tolerance)
    spanned = jnp.linalg.qr(unit[:, None] * directions)[0]
    return variance * covariance * outer(unit * scales), curvatures, spanned, unobservable


@checked
def describe_unobservable(skeleton: Skeleton, result: Uncertainty) -> list[str]:
    """Write a line for each unobservable direction, with its largest components of the pose."""
    names = dof_layout(skeleton).names
    lines = []
    for column in np.flatnonzero(np.asarray(result.unobservable)):
        direction = np.asarray(result.directions[:, column])
        largest = np.argsort(-np.abs(direction))[:3]
        parts = [f"{direction[k]:+.2f} {names[k]}" for k in largest if abs(direction[k]) > 0.1]
        lines.append("The data do not determine " + ", ".join(parts) + ".")
    return lines
