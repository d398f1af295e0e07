"""Features of a pose on which pose-dependent displacements depend."""

import abc

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ...geometry import rotation
from ..geometric_jacobian import GeometricJacobian
from ..kinematics import Transforms
from ..pose import Pose


class AbstractPoseFeatures(eqx.Module):
    """Numbers that depend on the rotation of each joint but the first, and are zero at rest."""

    @property
    @abc.abstractmethod
    def num_of_joint(self) -> int:
        """The number of features of one joint."""

    @abc.abstractmethod
    def of_rotation(self, q: Float[Array, "4"]) -> Float[Array, "M"]:
        """Compute the features of one joint from its unit quaternion."""

    def of_rotations(self, rotations: Float[Array, "J 4"]) -> Float[Array, "P"]:
        """Compute the features of all joints but the first, joint by joint."""
        return jax.vmap(self.of_rotation)(rotations[1:]).reshape(-1)

    def num_features(self, num_joints: int) -> int:
        """Return the number of features for a skeleton of so many joints."""
        return self.num_of_joint * (num_joints - 1)


class RotationMatrixFeatures(AbstractPoseFeatures):
    """The entries of `R_j - I`, row by row (SMPL, Loper et al. 2015, eq. 9)."""

    @property
    def num_of_joint(self):
        return 9

    def of_rotation(self, q):
        return (rotation.to_matrix(q) - jnp.eye(3, dtype=q.dtype)).reshape(-1)


class QuaternionFeatures(AbstractPoseFeatures):
    """`(x, y, z, w - 1)` of the unit quaternion (STAR, Osman et al. 2020, section 3).

    The sign of a quaternion is that with `w` of at least zero, as for rotations by at most half a turn.
    """

    @property
    def num_of_joint(self):
        return 4

    def of_rotation(self, q):
        q = q * jnp.where(q[0] < 0, -1.0, 1.0)
        return jnp.append(q[1:], q[0] - 1.0)


def feature_velocities(
    features: AbstractPoseFeatures, pose: Pose, transforms: Transforms, rates: GeometricJacobian
) -> Float[Array, "N M"]:
    """Differentiate the features of the joint of each parameter by this parameter; those of other joints do not depend on it.

    A parameter that rotates the descendants of its joint about the world axis `a` rotates the joint in its own frame,
    `R <- R exp(w)`, by `w = A^T a`, with the rotation `A` of the joint's bone in the world.
    """
    joints = jnp.asarray(rates.joints)
    bones = transforms.rotations[joints] / pose.scale
    w = jnp.einsum("nba,nb->na", bones, rates.angular)
    q = pose.rotations[joints]
    moved = jax.vmap(rotation.multiply)(q, jnp.concatenate([jnp.zeros_like(w[:, :1]), 0.5 * w], 1))
    return jax.vmap(lambda q, dq: jax.jvp(features.of_rotation, (q,), (dq,))[1])(q, moved)
