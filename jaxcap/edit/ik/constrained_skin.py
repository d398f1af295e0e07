"""A skin of constrained points: some on a body's surface, others fixed to its bones."""

import jax.numpy as jnp
from jaxtyping import Array, Bool

from ...body.skin import AbstractSkin, RigidSkin


class ConstrainedSkin(AbstractSkin):
    """A skin that combines surface points with points that move rigidly with a bone, such as joint centres.

    Both skins have all rows, and `rigid (C,)` selects between them. The overhead is negligible for few
    points. The selection is data, so it may change without a retrace.
    """

    skin: AbstractSkin
    bones: RigidSkin
    rigid: Bool[Array, "C"]

    def deform(self, vertices, skeleton, pose, transforms):
        on_bones = self.bones.deform(vertices, skeleton, pose, transforms)
        return jnp.where(
            self.rigid[:, None], on_bones, self.skin.deform(vertices, skeleton, pose, transforms)
        )

    def dominant_bones(self):
        return jnp.where(self.rigid, self.bones.dominant_bones(), self.skin.dominant_bones())

    def bone_weights(self, num_bones):
        return jnp.where(
            self.rigid[:, None], self.bones.bone_weights(num_bones), self.skin.bone_weights(num_bones)
        )

    def take(self, vertices):
        return ConstrainedSkin(self.skin.take(vertices), self.bones.take(vertices), self.rigid[vertices])

    def transfer(self, corners, barycentric, skeleton):
        """Raise `NotImplementedError`: there are no triangles between constrained points."""
        raise NotImplementedError("Constrained points have no surface; carry the skin of their body.")

    def scaled(self, factor):
        return ConstrainedSkin(self.skin.scaled(factor), self.bones.scaled(factor), self.rigid)

    def jacobian(self, vertices, directions, skeleton, pose, transforms, rates):
        on_bones, on_skin = (
            skin.jacobian(vertices, directions, skeleton, pose, transforms, rates)
            for skin in (self.bones, self.skin)
        )
        return jnp.where(self.rigid[:, None, None], on_bones, on_skin)
