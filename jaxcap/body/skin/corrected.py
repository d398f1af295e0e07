"""Pose-dependent displacements of the surface at rest, before any other skin."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...errors import InputError
from ..geometric_jacobian import GeometricJacobian
from ..kinematics import Transforms
from ..pose import Pose
from ..skeleton import Skeleton
from .interpolate import clamp_barycentric
from .pose_features import AbstractPoseFeatures, feature_velocities
from .skin import AbstractSkin


class CorrectedSkin(AbstractSkin):
    """A skin with pose-dependent displacements at rest: `v' = skin(v + directions . features(pose))`.

    Such displacements ("pose blend shapes", "correctives") compensate for the volume that a skin loses at bent joints, as in
    SMPL (Loper et al. 2015, eq. 9) and STAR. A `layer` combines the features into P units. The displacements are
    `directions . units(pose)`. If the layer is `rectified`, they are a small network, with the units
    `max(layer features(pose), 0)`, as in MHR (Ferguson et al. 2025). If not, they are linear in the features, with a rank of at
    most P, as in learned bodies.
    """

    skin: AbstractSkin
    features: AbstractPoseFeatures
    #: displacement of each vertex for a feature of one, or a unit of the layer, metres
    directions: Float[Array, "V 3 P"]
    #: weights of the P units of a layer for all features; no layer if None
    layer: Float[Array, "P N"] | None = None
    #: true if negative values of the units of a layer count as zero
    rectified: bool = eqx.field(static=True, default=True)

    def __check_init__(self):
        bones = self.skin.dominant_bones()
        if len(bones) != len(self.directions):
            raise InputError(
                f"CorrectedSkin: `directions` have {len(self.directions)} vertices and `skin` {len(bones)}; expected the same "
                "number."
            )

    def units(self, pose: Pose) -> Float[Array, "P"]:
        """Compute the factors of the directions in a pose: the units of the layer, or the features."""
        values = self.features.of_rotations(pose.rotations)
        if self.layer is None:
            return values
        units = self.layer @ values
        return jnp.maximum(units, 0.0) if self.rectified else units

    def displacements(self, pose: Pose) -> Float[Array, "V 3"]:
        """Compute the displacements of the vertices at rest, metres."""
        return self.directions @ self.units(pose)

    def deform(self, vertices, skeleton, pose, transforms):
        return self.skin.deform(vertices + self.displacements(pose), skeleton, pose, transforms)

    def dominant_bones(self):
        return self.skin.dominant_bones()

    def bone_weights(self, num_bones):
        return self.skin.bone_weights(num_bones)

    def take(self, vertices):
        return self._with(self.skin.take(vertices), self.directions[vertices])

    def transfer(self, corners, barycentric, skeleton):
        """Interpolate the directions of the corners, and transfer the skin."""
        shares, corners = clamp_barycentric(barycentric), np.asarray(corners)
        directions = np.asarray(self.directions)
        # one corner after the other, because all at once take three times the memory
        carried = sum(shares[:, k, None, None] * directions[corners[:, k]] for k in range(3))
        skin = self.skin.transfer(corners, barycentric, skeleton)
        return self._with(skin, jnp.asarray(carried, self.directions.dtype))

    def scaled(self, factor):
        return self._with(self.skin.scaled(factor), factor * self.directions)

    def jacobian(self, vertices, directions, skeleton, pose, transforms, rates):
        """Differentiate the skin, and add the displacements' own derivatives, carried along by the skin."""
        shaped = vertices + self.displacements(pose)
        rows = self.skin.jacobian(shaped, directions, skeleton, pose, transforms, rates)
        along_rest = self._along_rest(shaped, directions, skeleton, pose, transforms)
        moved = self._displacement_velocities(pose, transforms, rates)
        # an explicit sum, as one small product per vertex is slow on a CPU
        return rows + sum(along_rest[:, :, a, None] * moved[:, None, a] for a in range(3))

    def _with(self, skin: AbstractSkin, directions: Float[Array, "V 3 P"]) -> "CorrectedSkin":
        return CorrectedSkin(skin, self.features, directions, self.layer, self.rectified)

    def _displacement_velocities(
        self, pose: Pose, transforms: Transforms, rates: GeometricJacobian
    ) -> Float[Array, "V 3 N"]:
        """Differentiate the displacements by the parameters."""
        of_joint = feature_velocities(self.features, pose, transforms, rates)
        factors = self.directions if self.layer is None else self.layer
        size, parts = self.features.num_of_joint, []
        # only the columns of a joint depend on its parameters
        for first, last in _runs(rates):
            joint = rates.joints[first]
            if joint > 0 and rates.turning[first]:
                parts.append(factors[..., size * (joint - 1) : size * joint] @ of_joint[first:last].T)
            else:
                parts.append(jnp.zeros((*factors.shape[:-1], last - first), factors.dtype))
        moved = jnp.concatenate(parts, -1)
        if self.layer is None:
            return moved
        if self.rectified:
            active = self.layer @ self.features.of_rotations(pose.rotations) > 0
            moved = jnp.where(active[:, None], moved, 0.0)
        return self.directions @ moved

    def _along_rest(
        self, vertices: Float[Array, "V 3"], directions, skeleton: Skeleton, pose: Pose, transforms
    ) -> Float[Array, "V R 3"]:
        """Compute the derivatives of the posed vertices along directions by their rest positions."""
        # a skin is affine in the rest position of each vertex
        still = self.skin.deform(vertices, skeleton, pose, transforms)
        columns = [
            self.skin.deform(vertices + axis, skeleton, pose, transforms) - still
            for axis in jnp.eye(3, dtype=vertices.dtype)
        ]
        return jnp.stack([jnp.sum(directions * column[:, None], 2) for column in columns], 2)


@eqx.filter_jit
def corrective_units(skin: CorrectedSkin, poses: Pose) -> Float[Array, "F P"]:
    """Compute the factors of the directions of a skin in all poses."""
    return jax.lax.map(skin.units, poses)


def _runs(rates: GeometricJacobian) -> list[tuple[int, int]]:
    """Split the parameters into runs of one joint that all change its rotation, or all do not: first and last plus one."""
    keys = list(zip(rates.joints, rates.turning, strict=True))
    ends = [k + 1 for k in range(len(keys)) if k + 1 == len(keys) or keys[k + 1] != keys[k]]
    return list(zip([0, *ends[:-1]], ends, strict=True))
