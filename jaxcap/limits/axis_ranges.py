"""Ranges of rotation about one axis of a joint, such as the flexion of a knee."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ..body.pose import Pose
from ..body.skeleton import Skeleton
from ..geometry import rotation
from .abstract_limits import AbstractLimits


class AxisRanges(AbstractLimits):
    """Ranges `[lower, upper]` of the component of some joints' rotation vectors along an axis, radians.

    A rotation vector is that of the joint's rotation from rest. Its other two components are free.
    """

    joints: tuple[str, ...] = eqx.field(static=True)
    #: unit axes, rest frame of the world
    axes: Float[Array, "J 3"]
    lower: Float[Array, "J"]
    upper: Float[Array, "J"]

    def residual(self, skeleton: Skeleton, pose: Pose):
        """Compute the excess of each component beyond its range, radians, negative below it."""
        vectors = rotation.log(pose.rotations[self.indices(skeleton)])
        return self._excess(jnp.sum(vectors * self.axes, -1))

    def residual_joints(self, skeleton: Skeleton):
        return jnp.asarray(self.indices(skeleton), jnp.int32)

    def project(self, skeleton: Skeleton, pose: Pose):
        """Clamp each component to its range; the others stay as they are."""
        joints = self.indices(skeleton)
        vectors = rotation.log(pose.rotations[joints])
        excess = self._excess(jnp.sum(vectors * self.axes, -1))[:, None]
        turned = rotation.exp(vectors - excess * self.axes)
        # only violated joints change, so that allowed ones stay bitwise equal
        rotations = jnp.where(excess != 0, turned, pose.rotations[joints]).astype(pose.rotations.dtype)
        return Pose(pose.translations, pose.rotations.at[joints].set(rotations), pose.scale)

    def indices(self, skeleton: Skeleton) -> Int[np.ndarray, "J"]:
        """Look up the joint of each range. Raises `KeyError` where the skeleton lacks one."""
        return np.array([skeleton.index(name) for name in self.joints], int)

    def _excess(self, angles: Float[Array, "J"]) -> Float[Array, "J"]:
        return angles - jnp.clip(angles, self.lower, self.upper)
