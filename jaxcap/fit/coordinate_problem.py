"""The generalised coordinates of one frame as a least-squares problem."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..body.body import Body, pose_body
from ..body.coordinates.coordinate_model import CoordinateModel, CoordinateTargets, pose_from_coordinates
from ..energy.energy import AbstractEnergy, safe_sqrt
from .linear_solvers.dense import DenseMatrix
from .pose_problem import LEVER_ARM
from .solvers.descent import ConstrainedInfo, StepConstraints
from .solvers.least_squares_problem import AbstractDenseProblem


class CoordinateProblem(AbstractDenseProblem[Float[Array, "Q"]]):
    """The problem of finding the coordinates of a body that minimise an energy.

    Locked coordinates and those that follow others do not change; clamped ones stay in their ranges. The energy is that of
    a pose, so that every energy serves.
    """

    energy: AbstractEnergy
    model: CoordinateModel
    #: the surface, or the markers, on the model's skeleton
    body: Body
    targets: CoordinateTargets | None = None

    def residual(self, y):
        r = self.energy.residual(pose_body(self.body, pose_from_coordinates(self.model, y)))
        if self.targets is None:
            return r
        return jnp.concatenate([r, safe_sqrt(self.targets.weights) * (y - self.targets.values)])

    def linearise(self, y):
        def moved(d):
            r = self.residual(self.retract(y, d))
            return r, r

        zero = jnp.zeros(len(self.model.free), y.dtype)
        jacobian, residual = jax.jacfwd(moved, has_aux=True)(zero)
        return residual, jacobian

    def information(self, y):
        residual, jacobian = self.linearise(y)
        scales, free = self.scales(), self.model.free
        jacobian = jacobian * scales
        low, high = (jnp.asarray(bound[free], y.dtype) for bound in self.model.bounds)
        bounds = StepConstraints(
            jnp.minimum((low - y[free]) / scales, 0.0), jnp.maximum((high - y[free]) / scales, 0.0)
        )
        return ConstrainedInfo(  # pyright: ignore[reportCallIssue]
            0.5 * (residual @ residual),
            jacobian.T @ residual,
            DenseMatrix(jacobian.T @ jacobian),
            constraints=bounds,
        )

    def retract(self, y, d):
        return y.at[self.model.free].add(d)

    def scales(self):
        angles = np.array([self.model.coordinates[index].is_angle for index in self.model.free])
        return jnp.where(angles, 1.0, jnp.asarray(LEVER_ARM, self.body.vertices.dtype))

    def describe_constraints(self):
        return "ranges of coordinates" if any(np.isfinite(np.concatenate(self.model.bounds))) else None
