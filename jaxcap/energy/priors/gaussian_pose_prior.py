"""The pose prior of whole poses: a normal distribution over joint rotations."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from ...arguments import check_fields
from ...body.pose import local_rotation_vectors
from ..energy import AbstractEnergy


class GaussianPrior(AbstractEnergy):
    """`|L^T (x - mean)|^2`, the squared Mahalanobis distance of a pose, over the rotation vectors `x` of some joints
    from rest, each in its joint's own frame.

    Joints are coupled: what some joints show predicts the others.
    """

    #: indices of the joints
    joints: tuple[int, ...] = eqx.field(static=True)
    mean: Float[Array, "J 3"]
    #: lower triangular `L`, with `L L^T` the inverse of the covariance
    factor: Float[Array, "D D"]
    #: for each joint that of the embedded human that it corresponds to, empty for none; empty if this is not known
    roles: tuple[str, ...] = eqx.field(static=True, default=())

    def __check_init__(self):
        check_fields(self)

    @property
    def joints_of_roles(self) -> dict[str, int]:
        """The joints that correspond to one of the embedded human, by its name."""
        return {role: joint for role, joint in zip(self.roles, self.joints, strict=False) if role}

    def residual(self, posed) -> Float[Array, "D"]:
        vectors = local_rotation_vectors(posed.body.skeleton, posed.pose)[jnp.asarray(self.joints)]
        return (vectors - self.mean).reshape(-1) @ self.factor
