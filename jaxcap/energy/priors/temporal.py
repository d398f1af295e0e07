"""Motion that goes on as it came: a frame's turns against those of its neighbours."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from ...body.body import Posed
from ...body.pose import Pose
from ...geometry import rotation
from ..energy import AbstractEnergy


class SecondDifference(AbstractEnergy):
    """How far the turn of every joint is from the middle of its turns in the frames `before` and `after`: the mean over joints
    of squares, radians squared (Adaptation, eq. 4.10).

    For one frame between others that stay; a window of frames at once is `adapt.poses.sliding_window.smooth_poses`.
    """

    before: Pose
    after: Pose

    def residual(self, posed: Posed) -> Float[Array, "R"]:
        apart = second_difference(self.before.rotations, posed.pose.rotations, self.after.rotations)
        return apart.reshape(-1) / jnp.sqrt(jnp.asarray(len(apart), apart.dtype))


def second_difference(
    before: Float[Array, "*frames J 4"],
    here: Float[Array, "*frames J 4"],
    after: Float[Array, "*frames J 4"],
    since: Float[Array, "*frames"] | float = 1.0,
    until: Float[Array, "*frames"] | float = 1.0,
) -> Float[Array, "*frames J 3"]:
    """Half the sum of the rotation vectors to the frame before and to the one after: those of eq. 4.10 from the pose
    between the two, so that none is near half a turn however far a motion turns in all.

    `since` and `until` are the frames from the one before and to the one after where some are missing: it is half the
    second derivative of the parabola through the three, none of a motion that is even.
    """
    back = rotation.conjugate(here)
    since, until = (jnp.asarray(gap, here.dtype)[..., None, None] for gap in (since, until))
    left, right = (rotation.log(rotation.multiply(back, there)) for there in (before, after))
    return (until * left + since * right) / (since * until * (since + until))
