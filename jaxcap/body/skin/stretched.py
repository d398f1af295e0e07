"""A skin whose bones are scaled and shifted, one by one, before they move."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from ..kinematics import Transforms
from .linear import LinearSkin
from .skin import AbstractSkin


class StretchedSkin(AbstractSkin):
    """Linear blending of bones of other proportions: `v' = sum_j w_vj T_j (a_j u + b_j)`.

    The vertices `v` of the body are those at rest, `v = sum_j w_vj (a_j u + b_j)`, as for any other skin, and `u` those of the
    proportions for which the surface was made. Momentum's characters have lengths of bones and sizes of parts besides the shape of
    their surface (MHR, Ferguson et al. 2025). The result differs from linear blending of `v` where bones of different proportions
    meet.
    """

    skin: LinearSkin
    #: size `a` of each bone, relative to the first proportions
    sizes: Float[Array, "J"]
    #: displacement `b` of each bone, metres
    shifts: Float[Array, "J 3"]

    def deform(self, vertices, skeleton, pose, transforms):
        return self.skin.deform(self._unstretched(vertices), skeleton, pose, self._stretched(transforms))

    def dominant_bones(self):
        return self.skin.dominant_bones()

    def bone_weights(self, num_bones):
        return self.skin.bone_weights(num_bones)

    def take(self, vertices):
        return StretchedSkin(self.skin.take(vertices), self.sizes, self.shifts)

    def transfer(self, corners, barycentric, skeleton):
        """Interpolate the weights of the corners."""
        return StretchedSkin(self.skin.transfer(corners, barycentric, skeleton), self.sizes, self.shifts)

    def scaled(self, factor):
        return StretchedSkin(self.skin, self.sizes, factor * self.shifts)

    def jacobian(self, vertices, directions, skeleton, pose, transforms, rates):
        """Differentiate the skin at the points of the stretched bones, which move as the bones do."""
        moved = self._stretched(transforms)
        return self.skin.jacobian(self._unstretched(vertices), directions, skeleton, pose, moved, rates)

    def _unstretched(self, vertices: Float[Array, "V 3"]) -> Float[Array, "V 3"]:
        """Compute the vertices of the first proportions from those at rest."""
        weights = self.skin.weights
        return (vertices - weights @ self.shifts) / (weights @ self.sizes)[:, None]

    def _stretched(self, transforms: Transforms) -> Transforms:
        """Compute the transforms of the bones from the first proportions."""
        moves = jnp.einsum("jab,jb->ja", transforms.rotations, self.shifts) + transforms.translations
        return Transforms(transforms.rotations * self.sizes[:, None, None], moves)
