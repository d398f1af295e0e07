"""Energies with a residual that depends on the pose through the motions of bones only."""

import abc

from jaxtyping import Array, Float, Int

from ...body.body import Posed
from ..energy import AbstractEnergy


class AbstractBoneEnergy(AbstractEnergy):
    """An energy with R residuals for each of C groups, each of which depends on the motions of K bones, or of all of them.

    It gives the derivative of these residuals by the bones, and the skeleton gives that of the bones, so that no automatic
    differentiation is needed (`pose_jacobian`).
    """

    @abc.abstractmethod
    def bone_jacobian(self, posed: Posed) -> tuple[Int[Array, "C K"] | None, Float[Array, "C K R 6"]]:
        """Get the bones, and the derivative of the residual by their velocities, at a posed body.

        A velocity is a field of the world, `x -> angular x x + linear`; the numbers are the angular, then the linear ones. Without
        bones, K is the number of joints, in their order. The residual has the same order, group by group, and depends on nothing else
        of the pose.
        """
