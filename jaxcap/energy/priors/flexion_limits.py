"""The ranges of a person's knees and elbows, which do not bend backwards."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ...arguments import checked
from ...body.matching.person_joints import has_named_limbs
from ...body.matching.plan import plan_retarget
from ...body.people.human import human
from ...body.skeleton import Skeleton
from ...geometry import rotation
from ...limits.axis_ranges import AxisRanges
from .human_prior import has_human_frames, retarget_rotation_vectors
from .joint_limits import JointLimits

#: least and largest flexion of the embedded human's joints from its rest pose, radians, without their side: 5 degrees of
#: hyperextension to 150 degrees of flexion; knees are flexed by 6 degrees at rest, elbows by 45
FLEXION = {"Leg": (-0.19, 2.51), "ForeArm": (-0.87, 1.83)}
#: the axis of flexion in a joint's own frame
FLEXION_AXIS = (0.0, 1.0, 0.0)


@checked
def human_flexion_limits(skeleton: Skeleton) -> JointLimits | None:
    """Return the limits of flexion of the knees and elbows of a person.

    A skeleton with the joint names and the rest pose of the embedded human has that human's axes. For another one with names of
    a person's joints, such as those of SMPL, the axes and ranges are those of the same poses, retargeted as
    `jaxcap.retarget` does. The result is None if the skeleton lacks arms or legs of a person, or their names are not known.
    """
    if has_human_frames(skeleton):
        return _make_limits(skeleton, *_human_ranges(skeleton))
    return _transferred_limits(skeleton) if has_named_limbs(skeleton) else None


def _human_ranges(skeleton: Skeleton) -> tuple[list[int], Float[np.ndarray, "K 3"], Float[np.ndarray, "K 2"]]:
    """Return the limited joints of a skeleton with the embedded human's names, their axes and their ranges."""
    sided = [(side + name, ends) for name, ends in FLEXION.items() for side in ("Left", "Right")]
    joints = [skeleton.index(name) for name, _ in sided]
    frames = skeleton.orientations[jnp.asarray(joints)]
    axes = rotation.rotate(frames, jnp.tile(jnp.asarray(FLEXION_AXIS, frames.dtype), (len(joints), 1)))
    return joints, np.asarray(axes, float), np.array([ends for _, ends in sided])


def _transferred_limits(skeleton: Skeleton) -> JointLimits | None:
    """Retarget the ends of the ranges to another skeleton; None if it is no person's, or is not upright at rest."""
    source = human(resolution="low", joints="tracking").skeleton
    try:
        plan = plan_retarget(source, skeleton)
    except ValueError:
        return None
    joints, axes, ranges = _human_ranges(source)
    rotations = jnp.tile(rotation.identity(), (2, source.num_joints, 1))
    for end in range(2):
        turns = rotation.about_axis(jnp.asarray(axes), jnp.asarray(ranges[:, end]))
        rotations = rotations.at[end, jnp.asarray(joints)].set(turns.astype(rotations.dtype))
    ends = retarget_rotation_vectors(source, skeleton, plan, rotations)
    followers = {own: joint for joint, own in plan.matches.pairs.items()}
    if not set(joints) <= set(followers):
        return None
    own = [followers[joint] for joint in joints]
    change = ends[1, own] - ends[0, own]
    axes = change / np.linalg.norm(change, axis=-1, keepdims=True)
    ranges = np.einsum("ekd,kd->ke", ends[:, own], axes)
    return _make_limits(skeleton, own, axes, ranges)


def _make_limits(
    skeleton: Skeleton, joints: list[int], axes: Float[np.ndarray, "K 3"], ranges: Float[np.ndarray, "K 2"]
) -> JointLimits:
    names, dtype = tuple(skeleton.names[joint] for joint in joints), skeleton.centres.dtype
    lower, upper = (jnp.asarray(ranges[:, end], dtype) for end in range(2))
    return JointLimits(AxisRanges(names, jnp.asarray(axes, dtype), lower, upper))
