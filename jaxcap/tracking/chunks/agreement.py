"""Agreement of a tracked frame with the same frame as a search found it."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from ...body.kinematics import forward_kinematics, joint_positions
from ...body.pose import Pose
from ...body.skeleton import Skeleton
from ..judge_frame import TrackedFrame

#: largest distance between the same joints of a tracked pose and of one that a search found, if they are the same pose but for fingers or a
#: turned hand, metres: searches found these at least as accurately
TOLERANCE = 0.15


def agrees(skeleton: Skeleton, tracked: TrackedFrame, found: TrackedFrame) -> bool:
    """Decide if tracking may continue from a frame as a good search found it, instead of as it was tracked.

    It may if both are the same pose (`TOLERANCE`), or if tracking had no good pose.
    """
    return tracked.verdict != "good" or pose_distance(skeleton, tracked.pose, found.pose) <= TOLERANCE


def pose_distance(skeleton: Skeleton, one: Pose, other: Pose) -> float:
    """Compute the largest distance between the same joints of two poses, metres."""
    return float(_pose_distance(skeleton, one, other))


@eqx.filter_jit
def _pose_distance(skeleton: Skeleton, one: Pose, other: Pose) -> Float[Array, ""]:
    first, second = (joint_positions(skeleton, forward_kinematics(skeleton, pose)) for pose in (one, other))
    return jnp.max(jnp.linalg.norm(first - second, axis=1))
