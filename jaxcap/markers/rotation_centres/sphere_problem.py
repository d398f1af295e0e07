"""The least-squares problem of a sphere through weighted positions."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...fit.linear_solvers.dense import DenseMatrix
from ...fit.linear_solvers.float64 import in_float64
from ...fit.solvers.descent import ConstrainedInfo
from ...fit.solvers.least_squares_problem import AbstractProblem
from ...fit.solvers.levenberg_marquardt import LevenbergMarquardt
from ...fit.solvers.minimise import minimise
from ...observe.clouds import padded_size

#: steps end at shorter ones, metres, or where rounding hides their gain
MIN_STEP = 1e-14
MAX_STEPS = 200


class SphereProblem(AbstractProblem[Float[Array, "4"]]):
    """Find the centre `c` and the radius `r`, as `(4,)`, that minimise `sum_f w_f (|v_f - c| - r)^2 + k |c - m|^2`.

    Positions `v` without weight are padding; `m` is the prior centre, with weight `k`.
    """

    track: Float[Array, "F 3"]
    weights: Float[Array, "F"]
    prior_centre: Float[Array, "3"]
    prior_weight: Float[Array, ""]

    def value(self, y):
        offsets = jnp.linalg.norm(self.track - y[:3], axis=1) - y[3]
        gap = y[:3] - self.prior_centre
        return 0.5 * (self.weights @ offsets**2 + self.prior_weight * (gap @ gap))

    def information(self, y):
        differences = self.track - y[:3]
        lengths = jnp.linalg.norm(differences, axis=1)
        units = differences / jnp.maximum(lengths, 1e-12)[:, None]
        rows = jnp.concatenate([-units, -jnp.ones((len(units), 1), units.dtype)], 1)
        pull = rows.T @ (self.weights * (lengths - y[3]))
        pull = pull.at[:3].add(self.prior_weight * (y[:3] - self.prior_centre))
        prior = self.prior_weight * jnp.diag(jnp.array([1.0, 1.0, 1.0, 0.0], y.dtype))
        matrix = DenseMatrix((rows * self.weights[:, None]).T @ rows + prior)
        return ConstrainedInfo(self.value(y), pull, matrix)  # pyright: ignore[reportCallIssue]

    def retract(self, y, d):
        return y + d

    def scales(self):
        return jnp.ones(4, self.track.dtype)


def solve_sphere(
    track: Float[np.ndarray, "F 3"],
    weights: Float[np.ndarray, "F"],
    prior_centre: Float[np.ndarray, "3"],
    prior_weight: float,
    start: Float[np.ndarray, "4"],
) -> Float[np.ndarray, "4"]:
    """Minimise a `SphereProblem` from a start near the minimum, as precisely as rounding allows."""
    missing = padded_size(len(track)) - len(track)
    padded = np.pad(track, ((0, missing), (0, 0)), mode="edge"), np.pad(weights, (0, missing))
    return np.asarray(in_float64(_solve, *padded, prior_centre, np.asarray(prior_weight), start))


@eqx.filter_jit
def _solve(track, weights, prior_centre, prior_weight, start) -> Float[Array, "4"]:
    problem = SphereProblem(track, weights, prior_centre, prior_weight)
    solver = LevenbergMarquardt(rtol=0.0, atol=MIN_STEP, damping=1e-3, relative=True)
    return minimise(problem, start, solver, MAX_STEPS).y
