"""A check of the closed-form derivative of an energy against automatic differentiation."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..arguments import checked
from ..body.body import Body, pose_body
from ..body.pose import Pose
from ..body.retraction import retract
from ..energy.check_energies import check_energy_arrays, explain_errors, flat_terms
from ..energy.energy import AbstractEnergy, energy_name
from ..errors import InputError
from .linearise import linearise


@checked
def check_jacobian(
    energy: AbstractEnergy, body: Body, pose: Pose, tolerance: float | None = None
) -> dict[str, float]:
    """Compare the Jacobian of each term with automatic differentiation of its residual.

    A term of your own with `vertex_jacobian` or `bone_jacobian` is fitted by that closed form. If it is wrong, a fit
    converges slowly, or to another place. Call this in the tests of such a term, at poses that are not at rest.

    **Arguments:** `tolerance` is the largest allowed difference, relative to the term's largest derivative; where not
    given it is the machine's precision to the power 0.6.

    Returns the relative difference of each term by its name.

    **Raises:** `InputError` with the term, the row and the parameter of the largest difference above the tolerance.
    """
    check_energy_arrays(energy, body)
    differences: dict[str, float] = {}
    for term in flat_terms(energy):
        with explain_errors(term, body, pose):
            given, expected = (np.asarray(part) for part in _jacobians(term, body, pose))
        size = max(float(np.abs(expected).max(initial=0.0)), float(np.finfo(expected.dtype).tiny))
        error = np.abs(given - expected) / size
        name, most = energy_name(term), float(error.max(initial=0.0))
        allowed = float(np.finfo(expected.dtype).eps) ** 0.6 if tolerance is None else tolerance
        # written so that NaN counts as wrong
        if not most <= allowed:
            row, column = np.unravel_index(
                int(np.nanargmax(np.where(np.isnan(error), np.inf, error))), error.shape
            )
            raise InputError(
                f"{name}: row {row} of its Jacobian is {given[row, column]:.6g} by parameter {column} of the pose, and "
                f"automatic differentiation of its residual gives {expected[row, column]:.6g}; correct "
                "`vertex_jacobian` or `bone_jacobian`."
            )
        differences[name] = max(most, differences.get(name, 0.0))
    return differences


@eqx.filter_jit
@jax.default_matmul_precision("highest")
def _jacobians(term: AbstractEnergy, body: Body, pose: Pose):
    def moved(d):
        return term.residual(pose_body(body, retract(body.skeleton, pose, d)))

    zero = jnp.zeros(body.skeleton.num_dofs, body.vertices.dtype)
    return linearise(term, body, pose)[1], jax.jacfwd(moved)(zero)
