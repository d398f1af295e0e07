"""The pose of one frame as a least-squares problem, linearised on the manifold of poses."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from ..body.body import Body, pose_body
from ..body.pose import Pose
from ..body.retraction import retract
from ..body.skeleton import Skeleton, dof_layout
from ..energy.energy import AbstractEnergy
from ..limits.rotation_vector_boxes import (
    BoxChart,
    PoseBoxes,
    make_box_chart,
    retract_within,
    transform_normal_equations,
)
from .frame_equations import NormalEquations, frame_equations, sum_equations
from .linear_solvers.dense import DenseMatrix
from .linearise import linearise
from .solvers.descent import ConstrainedInfo, StepConstraints
from .solvers.least_squares_problem import AbstractDenseProblem

#: metres that the rotation of a joint by a radian moves its descendants by, about
LEVER_ARM = 0.3


class PoseProblem(AbstractDenseProblem[Pose]):
    """The problem of finding the pose of a body that minimises an energy.

    Within hard `boxes` tangents are coordinates of the boxes' chart about the pose, in which boxes are
    bounds.
    """

    energy: AbstractEnergy
    body: Body
    boxes: PoseBoxes | None = None
    #: equations, at the pose of a single step, of further terms whose rows are summed before (`take_step`)
    summed: NormalEquations | None = None

    def residual(self, y: Pose):
        return self.energy.residual(pose_body(self.body, y))

    def linearise(self, y: Pose):
        residual, jacobian = linearise(self.energy, self.body, y)
        return residual, jacobian if self.boxes is None else jacobian @ self._chart(self.boxes, y).basis

    def information(self, y: Pose):
        scales = self.scales()
        equations = frame_equations(self.energy, self.body, y)
        if self.summed is not None:
            equations = sum_equations([equations, self.summed])
        value, gradient, matrix = equations
        bounds = None
        if self.boxes is not None:
            chart = self._chart(self.boxes, y)
            matrix, gradient = transform_normal_equations(chart, matrix, gradient)
            bounds = StepConstraints(chart.lower / scales, chart.upper / scales)
        hessian = DenseMatrix(matrix * scales[:, None] * scales)
        return ConstrainedInfo(value, gradient * scales, hessian, constraints=bounds)  # pyright: ignore[reportCallIssue]

    def retract(self, y: Pose, d: Float[Array, "D"]):
        skeleton = self.body.skeleton
        if self.boxes is None:
            return retract(skeleton, y, d)
        return retract_within(self.boxes, skeleton, y, self._chart(self.boxes, y), d)

    def describe_constraints(self):
        return None if self.boxes is None else "pose boxes"

    def scales(self):
        return pose_scales(self.body.skeleton)

    def _chart(self, boxes: PoseBoxes, y: Pose) -> BoxChart:
        return make_box_chart(boxes, self.body.skeleton, y)


def pose_scales(skeleton: Skeleton) -> Float[Array, "D"]:
    """Compute the scales that bring metres and radians of a pose's tangent to one measure."""
    layout = dof_layout(skeleton)
    scales = jnp.ones(skeleton.num_dofs + 1, skeleton.centres.dtype)
    return scales.at[layout.translations].set(LEVER_ARM)[:-1]
