"""Points of a body with target positions (Kineben, eq. 2)."""

import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from ...arguments import checked
from ...body.body import Posed
from ..energy import AbstractEnergy, root, where_weighed
from .vertices import AbstractVertexEnergy, along_axes


class VertexLandmarks(AbstractVertexEnergy):
    """`sum_i w_i |x_i - y_i|^2` over chosen vertices, metres.

    A weight of zero marks a landmark that was not observed; its target may be NaN.
    """

    vertices: Int[Array, "C"]
    targets: Float[Array, "C 3"]
    weights: Float[Array, "C"]

    def residual(self, posed):
        return _apart(self.weights, posed.vertices[self.vertices], self.targets)

    def slopes(self, posed: Posed):
        del posed
        return self.vertices, along_axes(self.weights)


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
        places = jnp.einsum("cab,cb->ca", r, self.rest) + t
        return _apart(self.weights, places, self.targets)


class JointLandmarks(AbstractEnergy):
    """`sum_j w_j |c_j - y_j|^2` over all joint centres, metres; a weight of zero marks a joint that was not
    observed.
    """

    targets: Float[Array, "J 3"]
    weights: Float[Array, "J"]

    def residual(self, posed: Posed):
        return _apart(self.weights, posed.joints, self.targets)


@checked
def joint_landmarks(targets: Float[Array, "J 3"], weights=None) -> JointLandmarks:
    """Make landmarks from target joint centres `targets (J, 3)`; `weights (J,)` default to one."""
    return JointLandmarks(targets, jnp.ones(len(targets), targets.dtype) if weights is None else weights)


def _apart(weights, places, targets) -> Float[Array, "R"]:
    """Compute weighted differences of positions from their targets."""
    return (root(weights)[:, None] * (places - where_weighed(weights, targets))).reshape(-1)
