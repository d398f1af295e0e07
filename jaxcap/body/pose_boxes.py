"""Boxes of rotation vectors: a least and a largest value for every number of a joint's turn."""

from collections.abc import Sequence

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..geometry import rotation
from .limits import AbstractLimits
from .pose import Pose, own_vectors
from .skeleton import KINDS, Skeleton


class PoseBoxes(AbstractLimits):
    """Each number of some joints' rotation vectors within `[lower, upper]` (Adaptation, section 4.1.1):
    a hard limit for each degree of freedom, which couples nothing.

    A rotation vector is the exponential map of the joint's turn from rest, in the joint's own frame:
    twist, flexion, sideways. It is at most pi long, so a box cannot reach past half a turn.
    """

    joints: tuple[str, ...] = eqx.field(static=True)
    lower: Float[Array, "J 3"]
    upper: Float[Array, "J 3"]

    def residual(self, skeleton: Skeleton, pose: Pose):
        """Each number beyond its range, radians, below it negative."""
        own = own_vectors(skeleton, pose)[self._indices(skeleton)]
        return (own - jnp.clip(own, self.lower, self.upper)).reshape(-1)

    def owners(self, skeleton: Skeleton):
        return jnp.repeat(jnp.asarray(self._indices(skeleton), jnp.int32), 3)

    def nearest(self, skeleton: Skeleton, pose: Pose):
        """Every number at the end of its range; nearest in these numbers. A universal joint may be
        left turned a little about its third axis."""
        joints = self._indices(skeleton)
        own = own_vectors(skeleton, pose)[joints]
        clamped = jnp.clip(own, self.lower, self.upper)
        turned = rotation.exp(rotation.rotate(skeleton.orientations[joints], clamped))
        # only what is beyond moves, so that what is allowed stays to the last bit
        moved = jnp.any(clamped != own, -1, keepdims=True)
        rotations = jnp.where(moved, rotation.normalise(turned), pose.rotations[joints])
        return Pose(pose.translations, pose.rotations.at[joints].set(rotations), pose.scale)

    def _indices(self, skeleton: Skeleton) -> np.ndarray:
        return np.array([skeleton.index(name) for name in self.joints], int)


def make_pose_boxes(
    joints: Sequence[str], lower: Float[np.ndarray, "J 3"], upper: Float[np.ndarray, "J 3"]
) -> PoseBoxes:
    """Checked boxes, radians. Raises `ValueError` where a lower bound is above its upper one."""
    for name, low, high in zip(joints, lower, upper, strict=True):
        if not (low <= high).all():
            raise ValueError(f"The box of joint '{name}' goes from {low} down to {high}; swap them.")
    return PoseBoxes(tuple(joints), jnp.asarray(lower, float), jnp.asarray(upper, float))


def turning_joints(skeleton: Skeleton) -> tuple[int, ...]:
    """The joints whose turns are part of a pose: all that turn but the roots, which only say where
    the whole body is headed."""
    return tuple(
        joint
        for joint, (parent, kind) in enumerate(zip(skeleton.parents, skeleton.kinds, strict=True))
        if parent >= 0 and KINDS[kind][1]
    )
