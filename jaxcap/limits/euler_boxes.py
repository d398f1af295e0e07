"""Boxes of Euler angles: the usual limits of ball joints."""

from collections.abc import Mapping
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ..arguments import checked
from ..body.pose import Pose
from ..body.skeleton import Skeleton
from ..geometry import rotation
from .abstract_limits import AbstractLimits


class EulerBox(NamedTuple):
    """The limit of one joint: ranges of its angles about three axes, radians.

    `frame (3, 3)` has the axes as columns, rest frame of the world; the rotation about the first is applied
    first.
    """

    lower: Float[np.ndarray, "3"]
    upper: Float[np.ndarray, "3"]
    frame: Float[np.ndarray, "3 3"]


class EulerBoxes(AbstractLimits):
    """Euler angles `R = Rot(z, c) Rot(y, b) Rot(x, a)` within `[lower, upper]`, where x, y, z are the axes
    of each joint's frame.

    These are the limits of `.asf` files for joints with three angles. They couple neither swing with twist
    nor a child with its parent.
    """

    joints: Int[Array, "E"]
    #: unit quaternions of the frames
    frames: Float[Array, "E 4"]
    lower: Float[Array, "E 3"]
    upper: Float[Array, "E 3"]

    def residual(self, skeleton: Skeleton, pose: Pose):
        """Compute the excess of each angle beyond its range, radians, negative below it."""
        angles = self._angles(pose)
        return (angles - jnp.clip(angles, self.lower, self.upper)).reshape(-1)

    def residual_joints(self, skeleton: Skeleton):
        return jnp.repeat(self.joints, 3)

    def project(self, skeleton: Skeleton, pose: Pose):
        """Clamp every angle to its range."""
        angles = self._angles(pose)
        clamped = jnp.clip(angles, self.lower, self.upper)
        axes = jnp.broadcast_to(jnp.eye(3, dtype=angles.dtype), (len(angles), 3, 3))
        x, y, z = (rotation.about_axis(axes[:, i], clamped[:, i]) for i in range(3))
        turned = rotation.multiply(z, rotation.multiply(y, x))
        turned = rotation.multiply(self.frames, rotation.multiply(turned, rotation.conjugate(self.frames)))
        moved = jnp.any(clamped != angles, -1, keepdims=True)
        turned = jnp.where(moved, rotation.normalise(turned), pose.rotations[self.joints])
        return Pose(pose.translations, pose.rotations.at[self.joints].set(turned), pose.scale)

    def _angles(self, pose: Pose) -> Float[Array, "E 3"]:
        """Compute the Euler angles; of the two equivalent triples, the one nearer to its box."""
        return nearest_euler_angles(pose.rotations[self.joints], self.frames, self.lower, self.upper)


def nearest_euler_angles(
    rotations: Float[Array, "E 4"],
    frames: Float[Array, "E 4"],
    lower: Float[Array, "#E 3"],
    upper: Float[Array, "#E 3"],
) -> Float[Array, "E 3"]:
    """Compute the angles about the axes of `frames`, within half a turn of the middle of the box and
    nearest to the box."""
    middle = (lower + upper) / 2
    m = rotation.to_matrix(
        rotation.multiply(rotation.conjugate(frames), rotation.multiply(rotations, frames))
    )
    across = jnp.sqrt(jnp.maximum(m[..., 0, 0] ** 2 + m[..., 1, 0] ** 2, 1e-20))
    first = jnp.arctan2(m[..., 2, 1], m[..., 2, 2])
    third = jnp.arctan2(m[..., 1, 0], m[..., 0, 0])
    second = jnp.arctan2(-m[..., 2, 0], across)
    triples = jnp.stack(
        [
            jnp.stack([first, second, third], -1),
            jnp.stack([first + jnp.pi, jnp.pi - second, third + jnp.pi], -1),
        ]
    )
    triples = middle + (triples - middle + jnp.pi) % (2 * jnp.pi) - jnp.pi
    beyond = jnp.sum((triples - jnp.clip(triples, lower, upper)) ** 2, -1, keepdims=True)
    return jnp.where(beyond[1] < beyond[0], triples[1], triples[0])


@checked
def make_euler_boxes(skeleton: Skeleton, boxes: Mapping[str, EulerBox]) -> EulerBoxes:
    """Create `EulerBoxes` from boxes by joint name; a left-handed frame has its last axis and range
    negated.

    **Raises:** `ValueError` where a joint is unknown, a lower angle is above its upper one, or a frame is
    not of unit axes at right angles.
    """
    joints, frames, lowers, uppers = [], [], [], []
    place = {name: joint for joint, name in enumerate(skeleton.names)}
    for name, box in boxes.items():
        if name not in place:
            raise ValueError(
                f"There is a box for joint '{name}', which is not in the skeleton; expected one of "
                f"{', '.join(skeleton.names)}."
            )
        lower, upper, frame = (np.array(part, float) for part in box)
        if not (lower <= upper).all():
            raise ValueError(
                f"The box of joint '{name}' has lower bounds {lower} above its upper bounds {upper}; swap them."
            )
        if not np.allclose(frame.T @ frame, np.eye(3), atol=1e-4):
            raise ValueError(
                f"The axes of the box of joint '{name}' are not orthonormal; expected unit axes at right angles."
            )
        if np.linalg.det(frame) < 0:
            frame[:, 2] *= -1
            lower[2], upper[2] = -upper[2], -lower[2]
        joints.append(place[name])
        frames.append(frame)
        lowers.append(lower)
        uppers.append(upper)
    return EulerBoxes(
        joints=jnp.asarray(joints, jnp.int32),
        frames=rotation.from_matrix(jnp.asarray(np.reshape(frames, (-1, 3, 3)), float)),
        lower=jnp.asarray(np.reshape(lowers, (-1, 3)), float),
        upper=jnp.asarray(np.reshape(uppers, (-1, 3)), float),
    )
