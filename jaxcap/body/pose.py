"""Poses and motions of a skeleton, and their tangent vectors."""

from collections.abc import Sequence
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ..arguments import check_fields, checked
from ..errors import InputError
from ..geometry import rotation
from ..stacking import concatenate_trees, device_array, stack_trees
from ..value_checks import check_rate
from .skeleton import Skeleton


class Pose(eqx.Module):
    """The translation and rotation of every joint from rest.

    Every rotation is a quaternion, for all kinds of joints; the kind only determines the tangents. `scale`
    is the similarity about the world's origin (Adaptation, 3.1); `retract` does not change it.

    Functions take one frame, `(J, ...)`; a `Motion` stacks poses, `(F, J, ...)`.
    """

    translations: Float[Array, "*frames J 3"]
    rotations: Float[Array, "*frames J 4"]
    scale: Float[Array, "*frames"]

    def __check_init__(self):
        check_fields(self)


class Motion(eqx.Module):
    """Poses stacked over frames, with their rate in frames per second."""

    poses: Pose
    rate: float = eqx.field(static=True, default=30.0)

    def __check_init__(self):
        check_fields(self)
        check_rate("Motion", self.rate)
        if self.poses.scale.ndim == 0:
            raise InputError(
                "Motion: `poses` is one pose; expected poses stacked over frames, such as those of "
                "stack_poses([pose])."
            )

    @property
    def num_frames(self) -> int:
        return self.poses.rotations.shape[0]

    def __len__(self) -> int:
        return self.num_frames

    def __getitem__(self, frame: int) -> Pose:
        """Return the pose of one frame, counted from the end where negative. Raises `IndexError`."""
        if not -len(self) <= frame < len(self):
            raise IndexError(f"There is no frame {frame} in a motion of {len(self)} frames.")
        return Pose(self.poses.translations[frame], self.poses.rotations[frame], self.poses.scale[frame])

    def slice(self, frames: slice) -> "Motion":
        """Select a range of frames; a step divides the rate."""
        return Motion(take_poses(self.poses, frames), self.rate / abs(frames.step or 1))


@checked
def rest_pose(skeleton: Skeleton) -> Pose:
    """Create the rest pose: zero translations, identity rotations and scale one."""
    dtype = skeleton.centres.dtype
    count = skeleton.num_joints
    return Pose(
        device_array(np.zeros((count, 3)), dtype),
        device_array(np.tile([1.0, 0.0, 0.0, 0.0], (count, 1)), dtype),
        device_array(1.0, dtype),
    )


@checked
def stack_poses(poses: Sequence[Pose], rate: float = 30.0) -> Motion:
    """Stack single poses into a `Motion`, differentiably. Raises `InputError` where there are none."""
    if not poses:
        raise InputError("stack_poses: `poses` is empty; expected at least one pose.")
    return Motion(stack_trees(poses), rate)


def take_poses(poses: Pose, frames: Int[np.ndarray | Array, "K"] | slice) -> Pose:
    """Select poses of a stack by index or by slice."""
    return Pose(poses.translations[frames], poses.rotations[frames], poses.scale[frames])


def concatenate_poses(parts: Sequence[Pose]) -> Pose:
    """Concatenate stacks of poses along their frames."""
    return concatenate_trees(parts)


@partial(jax.jit, inline=True)
def shift_roots(skeleton: Skeleton, poses: Pose, shifts: Float[np.ndarray | Array, "*frames 3"]) -> Pose:
    """Translate a pose, or each pose of a stack, as a whole in the world by its own `shifts`, metres."""
    roots = np.flatnonzero(np.array(skeleton.parents) < 0)
    # the pose's scale is applied after the translations
    steps = jnp.asarray(shifts, poses.translations.dtype) / poses.scale[..., None]
    translations = poses.translations.at[..., roots, :].add(steps[..., None, :])
    return Pose(translations, poses.rotations, poses.scale)


@partial(jax.jit, inline=True)
def revolute_angles(skeleton: Skeleton, pose: Pose) -> Float[Array, "J"]:
    """Compute the twist angle of every joint about its first axis, in `[-pi, pi]`; for revolute joints, the
    joint angle."""
    return rotation.angle_about(pose.rotations, skeleton.axes[:, 0])


@partial(jax.jit, inline=True)
def universal_angles(skeleton: Skeleton, pose: Pose) -> Float[Array, "J 2"]:
    """Compute the two angles of universal joints, `R = Rot(axis 0, first) Rot(axis 1, second)`; rows of
    other joints have no meaning."""
    return rotation.angles_about(pose.rotations, skeleton.axes[:, 0], skeleton.axes[:, 1])


@partial(jax.jit, inline=True)
def local_rotation_vectors(skeleton: Skeleton, pose: Pose) -> Float[Array, "J 3"]:
    """Compute every joint's rotation from rest as a rotation vector in the joint's own frame, radians."""
    return rotation.rotate(rotation.conjugate(skeleton.orientations), rotation.log(pose.rotations))
