"""Swing-twist skinning: twists blend as dual quaternions, swings linearly."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ...arguments import checked
from ...geometry import dual_quaternions
from ...small_matrices import apply_small, multiply_small
from ..geometric_jacobian import descendant_matrix, project_velocities
from ..joint_swing_twist import decompose_joints
from ..skeleton import Skeleton
from .interpolate import interpolate
from .skin import AbstractSkin


class SwingTwistSkin(AbstractSkin):
    """Every vertex has a base bone, and the child joints of that bone are blended (Adaptation, eqs. 3.1 and
    3.13 to 3.18; after Kavan and Sorkine 2012): `x = T_base S(v)`.

    `S` blends the joints' own motions, each about its rest centre. First come the twists about the joints'
    own x axes, as dual quaternions with weights `twist`. The identity has the remaining weight, and the
    signs follow the motion of largest weight. Then come the swings, linearly, with weights `swing` and the
    remaining weight for the identity. A joint's own translation belongs to its swing. Last, the transform
    of the base bone, which includes the pose's scale, is applied.

    A joint of weight one with its parent as base gives the same map as that joint as base without weights.
    So weights can move along a chain past its joints continuously.

    - `bases (V,)` bones.
    - `swing (V, J)`, `twist (V, J)`: at least zero, non-zero only at children of the vertex's base, rows at
      most one in sum.
    """

    bases: Int[Array, "V"]
    swing: Float[Array, "V J"]
    twist: Float[Array, "V J"]

    def deform(self, vertices, skeleton, pose, transforms):
        split = decompose_joints(skeleton, pose)
        weights, motions = self._signed_weights(split.twists)
        twisted = dual_quaternions.apply(weights @ motions, vertices)
        swings = self._blend_swings(split.swings)
        swung = apply_small(swings[:, :, :3], twisted) + swings[:, :, 3]
        r, t = transforms.rotations[self.bases], transforms.translations[self.bases]
        return apply_small(r, swung) + t

    def _signed_weights(self, twists: Float[Array, "J 8"]) -> tuple[Float[Array, "V K"], Float[Array, "K 8"]]:
        """Compute signed weights of all joints' twists and, last, of the identity; and these motions."""
        neutral = 1.0 - jnp.sum(self.twist, 1, keepdims=True)
        motions = jnp.concatenate([twists, dual_quaternions.identity(twists.dtype)[None]])
        return dual_quaternions.align(jnp.concatenate([self.twist, neutral], 1), motions), motions

    def _blend_swings(self, swings: Float[Array, "J 3 4"]) -> Float[Array, "V 3 4"]:
        still = jnp.eye(3, 4, dtype=swings.dtype)
        return (self.swing @ (swings - still).reshape(-1, 12)).reshape(-1, 3, 4) + still

    def dominant_bones(self):
        return jnp.argmax(self.bone_weights(self.swing.shape[1]), 1)

    def bone_weights(self, num_bones):
        """Compute the mean of swing and twist weights; the base has the rest."""
        del num_bones
        return (add_base_weight(self.swing, self.bases) + add_base_weight(self.twist, self.bases)) / 2

    def take(self, vertices):
        return SwingTwistSkin(self.bases[vertices], self.swing[vertices], self.twist[vertices])

    def transfer(self, corners, barycentric, skeleton):
        """Interpolate the weights of the corners, on the base that keeps most of them."""
        rows = [
            interpolate(np.asarray(add_base_weight(weights, self.bases)), corners, barycentric)
            for weights in (self.swing, self.twist)
        ]
        return assign_bases(rows[0], rows[1], skeleton, self.swing.dtype)

    def scaled(self, factor):
        del factor
        return self

    def jacobian(self, vertices, directions, skeleton, pose, transforms, rates):
        """Move the base with the joints above it, and add the weighted twist and swing rates of each child.

        No parameter needs a pass over the surface.
        """
        split = decompose_joints(skeleton, pose)
        weights, motions = self._signed_weights(split.twists)
        blended = weights @ motions
        twisted = dual_quaternions.apply(blended, vertices)
        swings = self._blend_swings(split.swings)
        swung = apply_small(swings[:, :, :3], twisted) + swings[:, :, 3]
        r, t = transforms.rotations[self.bases], transforms.translations[self.bases]
        posed = apply_small(r, swung) + t
        rows = (
            project_velocities(posed, directions, rates)
            * descendant_matrix(skeleton, rates)[self.bases][:, None]
        )
        # directions in the frame before the base moves, and before the swing
        inner = multiply_small(directions, r)
        innermost = multiply_small(inner, swings[:, :, :3])
        joints = np.array(rates.joints)
        pulled = dual_quaternions.pull_back(blended, vertices, innermost)
        rows += weights[:, joints][:, None] * (pulled @ rates.twist.T)
        homogeneous = jnp.concatenate([twisted, jnp.ones_like(twisted[:, :1])], 1)
        levers = (inner[..., None] * homogeneous[:, None, None]).reshape(*inner.shape[:2], 12)
        return rows + self.swing[:, joints][:, None] * (levers @ rates.swing.reshape(-1, 12).T)


@checked
def swing_twist_from(skin: AbstractSkin, skeleton: Skeleton) -> SwingTwistSkin:
    """Convert any skin to a swing-twist skin, such as that of a body with LBS weights.

    Each vertex gets the base that, with its children, has most of the vertex's influences. The rest is
    reassigned: from deeper descendants to the child above them, and everything else to the base. So where
    one joint swings alone, a vertex with that joint as a child of its base moves as under LBS.

    **Raises:** `ValueError` where the skin is for another number of bones.
    """
    rows = np.asarray(skin.bone_weights(skeleton.num_joints))
    if rows.shape[1] != skeleton.num_joints:
        raise ValueError(
            f"The skin is for {rows.shape[1]} bones and the skeleton has {skeleton.num_joints} joints; "
            "give the skeleton that the skin was made for."
        )
    return assign_bases(rows, rows, skeleton, rows.dtype)


def add_base_weight(weights: Float[Array, "V J"], bases: Int[Array, "V"]) -> Float[Array, "V J"]:
    """Add the remaining weight of each row to the base."""
    rest = 1.0 - jnp.sum(weights, 1, keepdims=True)
    return weights + jnp.where(bases[:, None] == jnp.arange(weights.shape[1]), rest, 0.0)


def assign_bases(
    swing: Float[np.ndarray, "V J"], twist: Float[np.ndarray, "V J"], skeleton: Skeleton, dtype
) -> SwingTwistSkin:
    """Convert influences of any bones, rows one in sum, to weights of the children of one base."""
    parents = np.array(skeleton.parents)
    hangs = parents[:, None] == np.arange(len(parents))
    swing, twist = np.asarray(swing, float), np.asarray(twist, float)
    mean = (swing + twist) / 2
    # among equal bases, the one with the largest weight of its own
    bases = np.argmax(mean @ hangs + (1 + 1e-6) * mean, 1)
    children = hangs[:, bases].T
    below = skeleton.descendants.T
    swing, twist = (np.where(children, weights @ below, 0.0) for weights in (swing, twist))
    return SwingTwistSkin(jnp.asarray(bases), jnp.asarray(swing, dtype), jnp.asarray(twist, dtype))
