"""Joint limits: zero inside, a residual that grows outside."""

from ...body.body import Posed
from ...limits.abstract_limits import AbstractLimits
from ..energy import AbstractEnergy


class JointLimits(AbstractEnergy):
    """Penalty of joints beyond their limits, in about radians: ranges of angles, cones (Kineben, eqs. 14, 15
    and 42), boxes, or learned surfaces (Limits, section 5.2).
    """

    limits: AbstractLimits

    def residual(self, posed: Posed):
        return self.limits.residual(posed.body.skeleton, posed.pose)
