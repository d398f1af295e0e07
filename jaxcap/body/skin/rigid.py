"""Rigid skinning: one bone for each vertex."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Int

from ...small_matrices import apply_small
from ..geometric_jacobian import descendant_matrix, project_velocities
from .skin import AbstractSkin


class RigidSkin(AbstractSkin):
    """Every vertex is fixed to one bone (Kineben, section 3.1, "Shape Model")."""

    bones: Int[Array, "V"]

    def deform(self, vertices, skeleton, pose, transforms):
        del skeleton, pose
        r, t = transforms.rotations[self.bones], transforms.translations[self.bones]
        return apply_small(r, vertices) + t

    def dominant_bones(self):
        return self.bones

    def bone_weights(self, num_bones):
        return (self.bones[:, None] == jnp.arange(num_bones)).astype(float)

    def take(self, vertices):
        return RigidSkin(self.bones[vertices])

    def transfer(self, corners, barycentric, skeleton):
        """Select the bones of the nearest corners."""
        del skeleton
        nearest = np.argmax(np.asarray(barycentric), 1)[:, None]
        return RigidSkin(self.bones[np.take_along_axis(np.asarray(corners), nearest, 1)[:, 0]])

    def scaled(self, factor):
        del factor
        return self

    def jacobian(self, vertices, directions, skeleton, pose, transforms, rates):
        """Evaluate the field of every parameter whose joint moves the vertex's bone; others are zero."""
        points = self.deform(vertices, skeleton, pose, transforms)
        return (
            project_velocities(points, directions, rates)
            * descendant_matrix(skeleton, rates)[self.bones][:, None]
        )
