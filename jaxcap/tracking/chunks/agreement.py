"""Agreement of a frame in two chunks."""

import math
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from ...body.kinematics import forward_kinematics, joint_positions
from ...body.pose import Pose
from ...body.skeleton import Skeleton
from ..judge_frame import TrackedFrame

#: largest distance between the same joints of two poses that are the same but for fingers or a turned hand, metres
TOLERANCE = 0.05


class Comparison(NamedTuple):
    """The last frame before a chunk, in the chunk before and in its own first frames."""

    #: largest distance between the same joints, metres; NaN where one of both is not good
    distance: float
    #: tracking may continue from the own frame
    agree: bool


def compare_frames(skeleton: Skeleton, before: TrackedFrame, own: TrackedFrame) -> Comparison:
    """Decide if tracking may continue from the `own` frame of a chunk instead of that of the chunk `before`.

    It may if both are good and the same pose (`TOLERANCE`), if only the own frame is good, or if both are lost.
    """
    if own.verdict != "good":
        return Comparison(math.nan, own.lost and before.lost)
    if before.verdict != "good":
        return Comparison(math.nan, True)
    distance = pose_distance(skeleton, before.pose, own.pose)
    return Comparison(distance, distance <= TOLERANCE)


def pose_distance(skeleton: Skeleton, one: Pose, other: Pose) -> float:
    """Compute the largest distance between the same joints of two poses, metres."""
    return float(_pose_distance(skeleton, one, other))


@eqx.filter_jit
def _pose_distance(skeleton: Skeleton, one: Pose, other: Pose) -> Float[Array, ""]:
    first, second = (joint_positions(skeleton, forward_kinematics(skeleton, pose)) for pose in (one, other))
    return jnp.max(jnp.linalg.norm(first - second, axis=1))
