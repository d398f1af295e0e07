"""Points of a body with target positions (Kineben, eq. 2)."""

import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from ...arguments import checked
from ...body.body import Posed
from ...small_matrices import apply_small
from ..energy import AbstractEnergy, mask_unweighted, safe_sqrt
from .vertices import AbstractVertexEnergy, axis_directions


class VertexLandmarks(AbstractVertexEnergy):
    """`sum_i w_i |x_i - y_i|^2` over chosen vertices, metres.

    A weight of zero marks a landmark that was not observed; its target may be NaN.
    """

    vertices: Int[Array, "C"]
    targets: Float[Array, "C 3"]
    weights: Float[Array, "C"]

    def residual(self, posed):
        return _weighted_residual(self.weights, posed.vertices[self.vertices], self.targets)

    def vertex_jacobian(self, posed: Posed):
        del posed
        return self.vertices, axis_directions(self.weights)


class BoneLandmarks(AbstractEnergy):
    """`sum_i w_i |T_b(i) p_i - y_i|^2`: points fixed to bones, such as optical markers or joint centres.

    `rest (C, 3)` are their positions in the rest pose, metres.
    """

    bones: Int[Array, "C"]
    rest: Float[Array, "C 3"]
    targets: Float[Array, "C 3"]
    weights: Float[Array, "C"]

    def residual(self, posed: Posed):
        r, t = posed.transforms.rotations[self.bones], posed.transforms.translations[self.bones]
        positions = apply_small(r, self.rest) + t
        return _weighted_residual(self.weights, positions, self.targets)


class JointLandmarks(AbstractEnergy):
    """`sum_j w_j |c_j - y_j|^2` over all joint centres, metres; a weight of zero marks a joint that was not
    observed.
    """

    targets: Float[Array, "J 3"]
    weights: Float[Array, "J"]

    def residual(self, posed: Posed):
        return _weighted_residual(self.weights, posed.joints, self.targets)


@checked
def joint_landmarks(targets: Float[Array, "J 3"], weights=None) -> JointLandmarks:
    """Make landmarks from target joint centres `targets (J, 3)`; `weights (J,)` default to one."""
    return JointLandmarks(targets, jnp.ones(len(targets), targets.dtype) if weights is None else weights)


def _weighted_residual(weights, positions, targets) -> Float[Array, "R"]:
    """Compute weighted differences of positions from their targets."""
    return (safe_sqrt(weights)[:, None] * (positions - mask_unweighted(weights, targets))).reshape(-1)
