"""A body as long on the left as on the right."""

import equinox as eqx
from jaxtyping import Array, Float

from ...body.body import Posed
from ...body.symmetry import length_differences
from ..energy import AbstractEnergy


class BoneSymmetry(AbstractEnergy):
    """Differences of the lengths of paired bones, metres (Adaptation, eq. 4.13): of the body and not of its pose, for whoever
    has joints among the unknowns. `pairs` of joints, left and right, as of `mirrored_joints`."""

    pairs: tuple[tuple[int, int], ...] = eqx.field(static=True)

    def residual(self, posed: Posed) -> Float[Array, "R"]:
        return length_differences(posed.body.skeleton, self.pairs)[0]
