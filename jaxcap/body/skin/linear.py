"""Linear blend skinning."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from .interpolate import interpolate_weights
from .skin import AbstractSkin


class LinearSkin(AbstractSkin):
    """Linear blend skinning: `v' = sum_j w_vj T_j v` (Magnenat-Thalmann 1988).

    `weights (V, J)` are at least zero and sum to one over the bones.
    """

    weights: Float[Array, "V J"]

    def deform(self, vertices, skeleton, pose, transforms):
        del skeleton, pose
        # one product (V x 4J)(4J x 3) is the fastest form on a CPU
        homogeneous = jnp.concatenate([vertices, jnp.ones_like(vertices[:, :1])], 1)
        spread = (self.weights[:, :, None] * homogeneous[:, None, :]).reshape(len(vertices), -1)
        bones = jnp.concatenate([transforms.rotations, transforms.translations[:, :, None]], 2)
        return spread @ jnp.swapaxes(bones, 1, 2).reshape(-1, 3)

    def parts(self):
        return jnp.argmax(self.weights, 1)

    def influence(self, num_bones):
        del num_bones
        return self.weights

    def take(self, vertices):
        return LinearSkin(self.weights[vertices])

    def carry(self, corners, shares, skeleton):
        """The weights between those of the corners."""
        del skeleton
        return LinearSkin(jnp.asarray(interpolate_weights(self.weights, corners, shares), self.weights.dtype))
