"""The interface of joint limits, the test of a pose against them, and several limits as one."""

import abc

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from ..arguments import check_fields, checked
from ..body.pose import Pose
from ..body.skeleton import Skeleton

#: largest residual of an allowed joint, about radians
TOLERANCE = 1e-6
#: largest number of turns in which several limits are projected onto
TURNS = 100


class AbstractLimits(eqx.Module):
    """The allowed rotations of joints, for one pose of a skeleton.

    Boxes, cones and learned surfaces have the same three methods, so that energies, checks and projections
    take any of them.
    """

    def __check_init__(self):
        check_fields(self)

    @abc.abstractmethod
    def residual(self, skeleton: Skeleton, pose: Pose) -> Float[Array, "C"]:
        """Compute the violation of each limit: zero where the pose is allowed, else about radians, or
        cosines for cones, of either sign."""

    @abc.abstractmethod
    def residual_joints(self, skeleton: Skeleton) -> Int[Array, "C"]:
        """Return the joint of each residual."""

    @abc.abstractmethod
    def project(self, skeleton: Skeleton, pose: Pose) -> Pose:
        """Project every limited joint onto its nearest allowed rotation; allowed joints stay unchanged."""


@checked
def allowed(limits: AbstractLimits, skeleton: Skeleton, pose: Pose) -> Bool[Array, "J"]:
    """Test if each joint is within its limits; joints without limits are."""
    beyond = jnp.abs(limits.residual(skeleton, pose))
    worst = jnp.zeros(skeleton.num_joints, beyond.dtype).at[limits.residual_joints(skeleton)].max(beyond)
    return worst <= TOLERANCE


class AllLimits(AbstractLimits):
    """A combination of several limits; poses are projected onto one after the other, in turn until all hold."""

    parts: tuple[AbstractLimits, ...]

    def residual(self, skeleton: Skeleton, pose: Pose):
        return jnp.concatenate([part.residual(skeleton, pose) for part in self.parts])

    def residual_joints(self, skeleton: Skeleton):
        return jnp.concatenate([part.residual_joints(skeleton) for part in self.parts])

    def project(self, skeleton: Skeleton, pose: Pose):
        def is_outside(state) -> Bool[Array, ""]:
            turn, pose = state
            return (turn < TURNS) & ~jnp.all(jnp.abs(self.residual(skeleton, pose)) <= TOLERANCE)

        def into_all(state):
            turn, pose = state
            for part in self.parts:
                pose = part.project(skeleton, pose)
            return turn + 1, pose

        return jax.lax.while_loop(is_outside, into_all, (0, pose))[1] if self.parts else pose
