"""The generalised coordinates of one frame as a least-squares problem."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from ..body.body import Body, pose_body
from ..body.coordinates.coordinate_model import (
    CoordinateModel,
    CoordinateTargets,
    follow_leaders,
    pose_from_coordinates,
)
from ..body.retraction import difference
from ..energy.energy import AbstractEnergy, safe_sqrt
from .linear_solvers.dense import DenseMatrix
from .linearise import linearise
from .pose_problem import LEVER_ARM
from .solvers.descent import ConstrainedInfo, StepConstraints
from .solvers.least_squares_problem import AbstractDenseProblem


class CoordinateProblem(AbstractDenseProblem[Float[Array, "Q"]]):
    """The problem of finding the coordinates of a body that minimise an energy.

    Coordinates that are not free do not change; clamped ones stay in their ranges. The energy is that of a pose, so that every
    energy serves.
    """

    energy: AbstractEnergy
    model: CoordinateModel
    #: the surface, or the markers, on the model's skeleton
    body: Body
    free: Bool[Array, "Q"]
    targets: CoordinateTargets | None = None

    def residual(self, y):
        r = self.energy.residual(pose_body(self.body, pose_from_coordinates(self.model, y)))
        if self.targets is None:
            return r
        return jnp.concatenate([r, safe_sqrt(self.targets.weights) * self._target_gaps(y)])

    def linearise(self, y):
        pose = pose_from_coordinates(self.model, y)
        residual, by_pose = linearise(self.energy, self.body, pose)

        def tangent(y):
            return difference(self.model.skeleton, pose, pose_from_coordinates(self.model, y))

        jacobian = jnp.where(self.free, by_pose @ jax.jacfwd(tangent)(y), 0.0)
        if self.targets is None:
            return residual, jacobian
        roots = safe_sqrt(self.targets.weights)
        slopes = jnp.where(self.free, jax.jacfwd(self._target_gaps)(y), 0.0)
        return (
            jnp.concatenate([residual, roots * self._target_gaps(y)]),
            jnp.concatenate([jacobian, roots[:, None] * slopes]),
        )

    def information(self, y):
        residual, jacobian = self.linearise(y)
        scales = self.scales()
        jacobian = jacobian * scales
        return ConstrainedInfo(  # pyright: ignore[reportCallIssue]
            0.5 * (residual @ residual),
            jacobian.T @ residual,
            DenseMatrix(jacobian.T @ jacobian).restricted(self.free),
            constraints=self._bounds(y),
        )

    def retract(self, y, d):
        return y + jnp.where(self.free, d, 0.0)

    def scales(self):
        angles = np.array([coordinate.is_angle for coordinate in self.model.coordinates])
        return jnp.where(angles, 1.0, jnp.asarray(LEVER_ARM, self.body.vertices.dtype))

    def describe_constraints(self):
        clamped = any(coordinate.is_clamped for coordinate in self.model.coordinates)
        return "ranges of coordinates" if clamped else None

    def _target_gaps(self, y: Float[Array, "Q"]) -> Float[Array, "Q"]:
        assert self.targets is not None
        return follow_leaders(self.model, y) - self.targets.values

    def _bounds(self, y: Float[Array, "Q"]) -> StepConstraints | None:
        """Bound steps by the ranges; a start outside of its range may stay."""
        if self.describe_constraints() is None:
            return None
        low, high = self.model.bounds
        scales = self.scales()
        return StepConstraints(jnp.minimum((low - y) / scales, 0.0), jnp.maximum((high - y) / scales, 0.0))
