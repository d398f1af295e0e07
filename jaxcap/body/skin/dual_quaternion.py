"""Dual quaternion skinning of the bones' world transforms."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from ...geometry import dual_quaternions, rotation
from ..geometric_jacobian import descendant_matrix
from ..kinematics import Transforms
from ..pose import Pose
from .interpolate import interpolate_weights
from .skin import AbstractSkin


class DualQuaternionSkin(AbstractSkin):
    """Dual quaternion linear blending of bones (DLB; Kavan, Collins, Zara and O'Sullivan 2008).

    It is `v' = d v d*` with `d = sum_j w_vj d_j` at unit length. The sign of each bone's `d_j` is the one
    nearer to the bone of the largest weight. The pose's scale is applied last. Twists preserve their
    volume, which linear blending loses; bends bulge. `weights (V, J)` are at least zero and sum to one over
    the bones.
    """

    weights: Float[Array, "V J"]

    def deform(self, vertices, skeleton, pose, transforms):
        del skeleton
        motions = bone_dual_quaternions(pose, transforms)
        return pose.scale * dual_quaternions.apply(
            dual_quaternions.align(self.weights, motions) @ motions, vertices
        )

    def dominant_bones(self):
        return jnp.argmax(self.weights, 1)

    def bone_weights(self, num_bones):
        del num_bones
        return self.weights

    def take(self, vertices):
        return DualQuaternionSkin(self.weights[vertices])

    def transfer(self, corners, barycentric, skeleton):
        """Interpolate the weights of the corners."""
        del skeleton
        return DualQuaternionSkin(
            jnp.asarray(interpolate_weights(self.weights, corners, barycentric), self.weights.dtype)
        )

    def scaled(self, factor):
        del factor
        return self

    def jacobian(self, vertices, directions, skeleton, pose, transforms, rates):
        """Differentiate the blend of each vertex by six unit fields at each bone.

        A bone's `d_j` moves with the field of the joints above it at the rate `(a + e b) d_j / 2`.
        """
        motions = bone_dual_quaternions(pose, transforms)
        weights = dual_quaternions.align(self.weights, motions)
        pulled = dual_quaternions.pull_back(weights @ motions, vertices, pose.scale * directions)
        # (J, 6, 8): the rate of each bone's dual quaternion by each unit field
        fields = dual_quaternions.from_twist(jnp.eye(6, dtype=motions.dtype))
        units = dual_quaternions.multiply(*jnp.broadcast_arrays(fields, motions[:, None]))
        wrench = jnp.repeat(weights, 6, 1)[:, None] * (pulled @ units.reshape(-1, 8).T)
        twists = jnp.concatenate([rates.angular, rates.linear / pose.scale], 1)
        below = descendant_matrix(skeleton, rates)
        return wrench @ (below[:, None] * twists.T).reshape(-1, below.shape[1])


def bone_dual_quaternions(pose: Pose, transforms: Transforms) -> Float[Array, "J 8"]:
    """Convert the bones' world transforms without the pose's scale to unit dual quaternions."""
    q = rotation.from_matrix(transforms.rotations / pose.scale)
    return dual_quaternions.from_rigid(q, transforms.translations / pose.scale)
