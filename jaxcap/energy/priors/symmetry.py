"""Symmetry of bone lengths between left and right."""

import equinox as eqx
from jaxtyping import Array, Float

from ...body.body import Posed
from ...body.symmetry import length_differences
from ..energy import AbstractEnergy


class BoneSymmetry(AbstractEnergy):
    """Differences of the lengths of paired bones, metres (Adaptation, eq. 4.13).

    They depend on the body and not on its pose, for problems with joint centres among the unknowns. `pairs`
    of joints, left and right, as of `mirrored_joints`.
    """

    pairs: tuple[tuple[int, int], ...] = eqx.field(static=True)

    def residual(self, posed: Posed) -> Float[Array, "R"]:
        return length_differences(posed.body.skeleton, self.pairs)[0]
