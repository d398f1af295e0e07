"""Joint angles of a person between anatomical axes: of one pose, and of motions."""

from functools import partial
from typing import Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..arguments import check_fields, checked
from ..body.euler_angles import GIMBAL_LOCK, matrix_euler_angles
from ..body.kinematics import forward_kinematics
from ..body.pose import Motion, Pose
from ..body.skeleton import Skeleton
from .anatomical_frames import AnatomicalFrames, find_anatomical_frames
from .conventions import WORLD, AngleConvention, angle_conventions


class JointAngles(eqx.Module):
    """Angles of a pose, `(A,)`, or of the frames of a motion, `(F, A)`, with their conventions."""

    values: Float[Array, "*frames A"]
    #: name, segments, order of rotations, axis, sign and source of each angle
    conventions: tuple[AngleConvention, ...] = eqx.field(static=True)
    #: segments that the skeleton does not have, so that their angles are left out
    missing: tuple[str, ...] = eqx.field(static=True, default=())
    #: frames per second; None for a single pose
    rate: float | None = eqx.field(static=True, default=None)
    unit: Literal["rad", "deg"] = eqx.field(static=True, default="rad")

    def __check_init__(self):
        check_fields(self)

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the angles, in the manner of OpenSim."""
        return tuple(convention.name for convention in self.conventions)

    def __getitem__(self, name: str) -> Float[Array, "*frames"]:
        """Return one angle by its name. Raises `KeyError` with the existing names."""
        if name not in self.names:
            raise KeyError(f"There is no angle '{name}'; there are {', '.join(self.names)}.")
        return self.values[..., self.names.index(name)]

    def describe_missing(self) -> str | None:
        """Describe the angles that are left out in one sentence; None if there are all."""
        if not self.missing:
            return None
        missing = ", ".join(self.missing)
        return f"the angles of {missing} are left out, as no joints of the skeleton determine their axes"

    def to_degrees(self) -> "JointAngles":
        """Convert to degrees."""
        if self.unit == "deg":
            return self
        return JointAngles(jnp.rad2deg(self.values), self.conventions, self.missing, self.rate, "deg")


@checked
def joint_angles(
    skeleton: Skeleton, motion: Motion | Pose, frames: AnatomicalFrames | None = None
) -> JointAngles:
    """Compute the joint angles of a person as biomechanics defines them, radians.

    They are angles between anatomical axes of the segments (Wu et al. 2002, 2005; Grood and Suntay 1983), not
    rotations from rest: a rest pose with raised arms has an elevation of the shoulder. Flexion, adduction and
    internal rotation are positive on both sides. `conventions` of the result describe each angle, and
    `docs/joint_angles.md` all of them. Angles lie within half a turn, except that `pelvis_rotation` of a motion
    continues from frame to frame. At gimbal lock the last angle is zero, and of a shoulder the plane of elevation.

    **Arguments:** `frames` are anatomical axes at rest, by default those of `find_anatomical_frames`.

    **Raises:** `InputError` if there is no person in the skeleton.
    """
    poses = motion.poses if isinstance(motion, Motion) else motion
    if frames is None:
        frames = find_anatomical_frames(skeleton, motion if isinstance(motion, Motion) else None)
    conventions = angle_conventions(frames.segments)
    if poses.scale.ndim == 0:
        return JointAngles(pose_angles(skeleton, frames, poses), conventions, frames.missing)
    values = _angles_of_poses(skeleton, frames, poses)
    for place, convention in enumerate(conventions):
        if convention.name == "pelvis_rotation":
            values = values.at[:, place].set(jnp.unwrap(values[:, place]))
    return JointAngles(
        values, conventions, frames.missing, motion.rate if isinstance(motion, Motion) else None
    )


@checked
@partial(jax.jit, inline=True)
def pose_angles(skeleton: Skeleton, frames: AnatomicalFrames, pose: Pose) -> Float[Array, "A"]:
    """Compute the angles of one pose in the order of `angle_conventions(frames.segments)`, radians.

    Differentiable, with finite derivatives everywhere except at gimbal lock, where angles jump.
    """
    turned = forward_kinematics(skeleton, pose).rotations[np.array(frames.bones, int)] / pose.scale
    axes = jnp.concatenate([turned @ frames.axes, frames.world[None]])
    names = (*frames.segments, WORLD)
    conventions = angle_conventions(frames.segments)
    angles = jnp.zeros(len(conventions), axes.dtype)
    for order in ("yxz", "zxy", "yxy"):
        columns = [column for column, each in enumerate(conventions) if each.order == order]
        own = [conventions[column] for column in columns]
        if not own:
            continue
        proximal = axes[np.array([names.index(each.proximal) for each in own])]
        distal = axes[np.array([names.index(each.distal) for each in own])]
        relative = jnp.swapaxes(proximal, -1, -2) @ distal
        # the mirror image of the left side: Z changes its sign
        mirror = np.array([[1, 1, -1 if each.mirrored else 1] for each in own])
        relative = relative * (mirror[:, :, None] * mirror[:, None, :])
        three = _elevation_angles(relative) if order == "yxy" else matrix_euler_angles(relative, order)
        one = three[np.arange(len(own)), np.array([each.position for each in own])]
        angles = angles.at[np.array(columns)].set(one * np.array([each.sign for each in own]))
    return angles


@jax.jit
def _angles_of_poses(skeleton: Skeleton, frames: AnatomicalFrames, poses: Pose) -> Float[Array, "F A"]:
    return jax.vmap(lambda pose: pose_angles(skeleton, frames, pose))(poses)


def _elevation_angles(m: Float[Array, "*shape 3 3"]) -> Float[Array, "*shape 3"]:
    """Decompose into rotations about Y, X and Y, the second one from -pi to 0 (Wu et al. 2005, 2.4.7)."""
    sine = m[..., 0, 1] ** 2 + m[..., 2, 1] ** 2
    free = sine > GIMBAL_LOCK**2
    # the humerus points down to (sin a sin e, -cos e, cos a sin e), e being the elevation
    plane = jnp.arctan2(jnp.where(free, -m[..., 0, 1], 0.0), jnp.where(free, -m[..., 2, 1], 1.0))
    elevation = jnp.arctan2(jnp.sqrt(jnp.where(free, sine, 1.0)), m[..., 1, 1])
    locked = jnp.where(m[..., 1, 1] > 0, 0.0, jnp.pi)
    axial = jnp.arctan2(
        jnp.where(free, -m[..., 1, 0], m[..., 0, 2]), jnp.where(free, m[..., 1, 2], m[..., 0, 0])
    )
    return jnp.stack([plane, -jnp.where(free, elevation, locked), axial], -1)
