"""Joint limits: nothing inside the range, a residual that grows outside of it."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from ..body.body import Posed
from ..body.limits import JointRanges
from ..body.pose import revolute_angles, universal_angles
from ..geometry import rotation
from .term import AbstractEnergy


class JointLimits(AbstractEnergy):
    """Penalty of angles beyond their range (Kineben, eq. 14), in radians, and of turned
    axes beyond their cone (eqs. 15 and 42), in cosines: `x_B . R x_B - t` where it is
    negative, with `t` the cosine of the cone's angle, for the heading and the bank axis.
    """

    ranges: JointRanges

    def residual(self, posed: Posed):
        limits, pose, skeleton = self.ranges, posed.pose, posed.body.skeleton
        first = jnp.asarray(revolute_angles(skeleton, pose))
        pairs = universal_angles(skeleton, pose)
        universal = jnp.array([kind == "universal" for kind in skeleton.kinds])[limits.joints]
        angles = jnp.where(universal, pairs[limits.joints, limits.numbers], first[limits.joints])
        # angles are known up to a turn: the one nearest to the middle of the range counts
        middle = (limits.lower + limits.upper) / 2
        angles = middle + (angles - middle + jnp.pi) % (2 * jnp.pi) - jnp.pi
        beyond = jnp.minimum(angles - limits.lower, 0.0) + jnp.maximum(angles - limits.upper, 0.0)
        turned = pose.rotations[limits.ball_joints]
        cones = [
            cone_residual(turned, axis, angle)
            for axis, angle in (
                (limits.heading, limits.heading_angle),
                (limits.bank, limits.bank_angle),
            )
        ]
        return jnp.concatenate([beyond, *cones])


def cone_residual(
    turned: Float[Array, "B 4"], axis: Float[Array, "B 3"], angle: Float[Array, "B"]
) -> Float[Array, "B"]:
    """`min(x_B . R x_B - cos(angle), 0)` (Kineben, eq. 15)."""
    return jnp.minimum(jnp.sum(axis * rotation.rotate(turned, axis), -1) - jnp.cos(angle), 0.0)
