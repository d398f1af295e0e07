"""How a surface follows its bones: one interface, a final class for each scheme."""

import abc

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from .kinematics import Transforms
from .pose import Pose
from .skeleton import Skeleton


class AbstractSkin(eqx.Module):
    """Binds every vertex of a body to its bones.

    A skin says where the vertices go (`deform`), which bone each one belongs to (`parts`),
    and how strongly each bone moves it (`influence`).
    """

    @abc.abstractmethod
    def deform(
        self, vertices: Float[Array, "V 3"], skeleton: Skeleton, pose: Pose, transforms: Transforms
    ) -> Float[Array, "V 3"]:
        """Posed positions `(V, 3)` of the rest `vertices (V, 3)`, metres."""

    @abc.abstractmethod
    def parts(self) -> Int[Array, "V"]:
        """The bone that each vertex belongs to."""

    @abc.abstractmethod
    def influence(self, num_bones: int) -> Float[Array, "V J"]:
        """Share of each bone in the motion of each vertex; rows sum to one."""


class RigidSkin(AbstractSkin):
    """Every vertex is fixed to one bone (Kineben, section 3.1, "Shape Model")."""

    bones: Int[Array, "V"]

    def deform(self, vertices, skeleton, pose, transforms):
        del skeleton, pose
        r, t = transforms.rotations[self.bones], transforms.translations[self.bones]
        return jnp.einsum("vab,vb->va", r, vertices) + t

    def parts(self):
        return self.bones

    def influence(self, num_bones):
        return (self.bones[:, None] == jnp.arange(num_bones)).astype(float)


class LinearSkin(AbstractSkin):
    """Linear blend skinning: `v' = sum_j w_vj T_j v` (Adaptation, eq. 3.1).

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
