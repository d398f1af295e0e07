"""Symmetry of bone lengths between left and right."""

import equinox as eqx
from jaxtyping import Array, Float

from ...body.body import Posed
from ...body.symmetry import length_differences
from ..energy import AbstractEnergy


class BoneSymmetry(AbstractEnergy):
    """Differences of the lengths of paired bones, metres (Adaptation, eq. 4.13).

    They depend on the body and not on its pose, for problems with joint centres among the unknowns.
    `left_right_pairs` of joints are as of `body.symmetry.find_left_right_pairs`.
    """

    left_right_pairs: tuple[tuple[int, int], ...] = eqx.field(static=True)

    def residual(self, posed: Posed) -> Float[Array, "R"]:
        return length_differences(posed.body.skeleton, self.left_right_pairs)[0]
