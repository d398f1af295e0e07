"""Smooth motion: a frame's rotations compared with those of its neighbours."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from ...body.body import Posed
from ...body.pose import Pose
from ...geometry import rotation
from ..energy import AbstractEnergy


class SecondDifference(AbstractEnergy):
    """Deviation of every joint's rotation from the midpoint of its rotations in the frames `before` and
    `after`: the mean over joints of squares, radians squared (Adaptation, eq. 4.10).

    For one frame between fixed neighbours; `adapt.poses.sliding_window.smooth_poses` solves a window of
    frames together.
    """

    before: Pose
    after: Pose

    def residual(self, posed: Posed) -> Float[Array, "R"]:
        differences = second_difference(self.before.rotations, posed.pose.rotations, self.after.rotations)
        return differences.reshape(-1) / jnp.sqrt(jnp.asarray(len(differences), differences.dtype))


def second_difference(
    before: Float[Array, "*frames J 4"],
    current: Float[Array, "*frames J 4"],
    after: Float[Array, "*frames J 4"],
    gap_before: Float[Array, "*frames"] | float = 1.0,
    gap_after: Float[Array, "*frames"] | float = 1.0,
) -> Float[Array, "*frames J 3"]:
    """Compute half the sum of the rotation vectors to the previous and to the next frame.

    These are those of eq. 4.10 relative to the middle pose, so that none is near half a turn, however large
    the total rotation of a motion.

    `gap_before` and `gap_after` are the numbers of frames from the previous and to the next one where some are
    missing: it is half the second derivative of the parabola through the three, zero for uniform motion.
    """
    back = rotation.conjugate(current)
    gap_before, gap_after = (
        jnp.asarray(gap, current.dtype)[..., None, None] for gap in (gap_before, gap_after)
    )
    left, right = (rotation.log(rotation.multiply(back, there)) for there in (before, after))
    return (gap_after * left + gap_before * right) / (gap_before * gap_after * (gap_before + gap_after))
