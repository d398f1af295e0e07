"""Linear blend skinning."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from ...stacking import device_array
from ..geometric_jacobian import descendant_matrix
from .interpolate import interpolate_weights
from .skin import AbstractSkin


class LinearSkin(AbstractSkin):
    """Linear blend skinning: `v' = sum_j w_vj T_j v` (Magnenat-Thalmann 1988).

    `weights (V, J)` are at least zero and sum to one over the bones.
    """

    weights: Float[Array, "V J"]

    def deform(self, vertices, skeleton, pose, transforms):
        del skeleton, pose
        # one product (V x J)(J x 12), which is also one for many poses, is the fastest form on a CPU
        bones = jnp.concatenate([transforms.rotations, transforms.translations[:, :, None]], 2)
        blended = (self.weights @ bones.reshape(-1, 12)).reshape(-1, 3, 4)
        x, y, z = (vertices[:, i, None] for i in range(3))
        return blended[:, :, 0] * x + blended[:, :, 1] * y + blended[:, :, 2] * z + blended[:, :, 3]

    def dominant_bones(self):
        return jnp.argmax(self.weights, 1)

    def bone_weights(self, num_bones):
        del num_bones
        return self.weights

    def take(self, vertices):
        return LinearSkin(self.weights[vertices])

    def transfer(self, corners, barycentric, skeleton):
        """Interpolate the weights of the corners."""
        del skeleton
        return LinearSkin(
            device_array(interpolate_weights(self.weights, corners, barycentric), self.weights.dtype)
        )

    def scaled(self, factor):
        del factor
        return self

    def jacobian(self, vertices, directions, skeleton, pose, transforms, rates):
        """Differentiate by a weighted sum over the bones below each joint,

            dx_v / dk = sum_{i below joint(k)} w_vi (a_k x T_i v + b_k),

        which takes one sum over the descendants of each joint, not a pass over the surface for each
        parameter. For one direction, `n . (a x p) = a . (p x n)` is used first: the moment `p x n` and the
        force `n` of each bone are summed.
        """
        del pose
        below = descendant_matrix(skeleton, rates)
        homogeneous = jnp.concatenate([vertices, jnp.ones_like(vertices[:, :1])], 1)
        bones = jnp.concatenate([transforms.rotations, transforms.translations[:, :, None]], 2)
        x, y, z = (self.weights * (homogeneous @ bones[:, i].T) for i in range(3))
        share = self.weights @ below
        if directions.shape[1] == 1:
            nx, ny, nz = (directions[:, 0, i : i + 1] for i in range(3))
            wrench = jnp.concatenate([y * nz - z * ny, z * nx - x * nz, x * ny - y * nx], 1)
            turned = wrench @ (below[None] * rates.angular.T[:, None, :]).reshape(-1, below.shape[1])
            return (turned + share * (directions[:, 0] @ rates.linear.T))[:, None]
        x, y, z = jnp.stack([x, y, z]) @ below
        a, b = rates.angular.T, rates.linear.T
        moved = (
            a[1] * z - a[2] * y + b[0] * share,
            a[2] * x - a[0] * z + b[1] * share,
            a[0] * y - a[1] * x + b[2] * share,
        )
        # an explicit sum, as one small product per vertex is slow on a CPU
        return sum(directions[:, :, i, None] * moved[i][:, None] for i in range(3))
