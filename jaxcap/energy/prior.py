"""A preference for poses near a given one, or near rest."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from ..body.body import Posed
from ..body.pose import Pose, difference, own_vectors
from ..body.skeleton import Skeleton, dof_layout
from .term import AbstractEnergy


class PosePrior(AbstractEnergy):
    """`sum_k (d_k / s_k)^2`, where `d` is the tangent from a reference pose to this one and
    `s (D,)` are standard deviations in metres and radians (infinite: free).

    Holds what the data do not show, damps a step, or ties a frame to its prediction.
    """

    reference: Pose
    deviations: Float[Array, "D"]

    def residual(self, posed: Posed):
        return difference(posed.body.skeleton, self.reference, posed.pose) / self.deviations


class RestPrior(AbstractEnergy):
    """`sum (w / s)^2` over the rotation vectors `w` of joints from rest, each in its joint's own
    frame (twist, flexion, sideways), with standard deviations `s (J, 3)` in radians (infinite:
    free). An elbow that bends sideways costs more than one that flexes."""

    deviations: Float[Array, "J 3"]

    def residual(self, posed: Posed):
        return (own_vectors(posed.body.skeleton, posed.pose) / self.deviations).reshape(-1)


def tangent_deviations(skeleton: Skeleton, metres: float, radians: float) -> Float[Array, "D"]:
    """A deviation for every number of a tangent: one for what slides, one for what turns."""
    deviations = jnp.full(skeleton.num_dofs + 1, radians, skeleton.centres.dtype)
    return deviations.at[dof_layout(skeleton).translations].set(metres)[:-1]
