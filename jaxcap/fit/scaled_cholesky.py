"""Linear least squares whose unknowns are of very different stiffness, in single precision."""

import jax.numpy as jnp
import lineax as lx
from jax.flatten_util import ravel_pytree

from .gauss_newton import try_damped_step


class ScaledCholesky(lx.AbstractLinearSolver):
    """Cholesky on normal equations that are first brought to a unit diagonal, and given back what rounding may take.

    `lx.Normal(lx.Cholesky())` fails where one point weighs 10^7 times as much as another; QR does not, but takes ten
    times as long. To take the place of either in `LevenbergMarquardt`, in forward mode. Where rounding leaves no
    factor, the result is `RESULTS.singular` and the step is not a number.
    """

    def init(self, operator, options):
        del options
        return operator.as_matrix()

    def compute(self, state, vector, options):
        del options
        right, _ = ravel_pytree(vector)
        step, solved = try_damped_step(right, state, jnp.zeros(state.shape[1], state.dtype))
        return -step, lx.RESULTS.where(solved, lx.RESULTS.successful, lx.RESULTS.singular), {}

    def transpose(self, state, options):
        raise NotImplementedError("Steps of a solver are not differentiated; its solution is.")

    def conj(self, state, options):
        return state, options

    def assume_full_rank(self):
        return True
