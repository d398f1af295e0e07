"""Swing-twist skinning: twists blend as dual quaternions, swings linearly."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ...arguments import checked
from ...geometry import dualquat
from ..geometric_jacobian import bones_below, field_rows
from ..joint_swing_twist import split_joints
from ..skeleton import Skeleton
from .interpolate import interpolate
from .skin import AbstractSkin


class SwingTwistSkin(AbstractSkin):
    """Every vertex rides on a base bone, and the joints that hang on that bone blend beside it
    (Adaptation, eqs. 3.1 and 3.13 to 3.18; after Kavan and Sorkine 2012): `x = T_base S(v)`.

    `S` blends the joints' own motions, each about its rest centre: first the twists about the
    joints' own x axes, as dual quaternions with weights `twist`, the identity with the rest, and
    the signs nearest to whichever of these weighs most; then the swings, linearly, with weights
    `swing` and the rest for what does not move. A joint's own shift counts to its swing. Then
    the transform of the base bone, which holds the pose's scale, moves the vertex with all above.

    Weight one at a joint and base its parent is the same map as that joint for a base and no
    weights: so do weights slide along a chain past its joints.

    - `bases (V,)` bones.
    - `swing (V, J)`, `twist (V, J)`: at least zero, non-zero at children of the vertex's base
      only, rows at most one in sum.
    """

    bases: Int[Array, "V"]
    swing: Float[Array, "V J"]
    twist: Float[Array, "V J"]

    def deform(self, vertices, skeleton, pose, transforms):
        split = split_joints(skeleton, pose)
        weights, motions = self._aligned(split.twists)
        twisted = dualquat.apply(weights @ motions, vertices)
        swings = self._blend_swings(split.swings)
        beside = jnp.einsum("vab,vb->va", swings[:, :, :3], twisted) + swings[:, :, 3]
        r, t = transforms.rotations[self.bases], transforms.translations[self.bases]
        return jnp.einsum("vab,vb->va", r, beside) + t

    def _aligned(self, twists: Float[Array, "J 8"]) -> tuple[Float[Array, "V K"], Float[Array, "K 8"]]:
        """Signed weights of all joints' twists and, last, of the neutral motion; and these motions."""
        neutral = 1.0 - jnp.sum(self.twist, 1, keepdims=True)
        motions = jnp.concatenate([twists, dualquat.identity(twists.dtype)[None]])
        return dualquat.align(jnp.concatenate([self.twist, neutral], 1), motions), motions

    def _blend_swings(self, swings: Float[Array, "J 3 4"]) -> Float[Array, "V 3 4"]:
        still = jnp.eye(3, 4, dtype=swings.dtype)
        return (self.swing @ (swings - still).reshape(-1, 12)).reshape(-1, 3, 4) + still

    def parts(self):
        return jnp.argmax(self.influence(self.swing.shape[1]), 1)

    def influence(self, num_bones):
        """The mean of swing and twist weights; the base has the rest."""
        del num_bones
        return (with_base(self.swing, self.bases) + with_base(self.twist, self.bases)) / 2

    def take(self, vertices):
        return SwingTwistSkin(self.bases[vertices], self.swing[vertices], self.twist[vertices])

    def carry(self, corners, shares, skeleton):
        """The weights between those of the corners, on the base that keeps most of them."""
        rows = [
            interpolate(np.asarray(with_base(weights, self.bases)), corners, shares)
            for weights in (self.swing, self.twist)
        ]
        return on_best_base(rows[0], rows[1], skeleton, self.swing.dtype)

    def jacobian(self, vertices, directions, skeleton, pose, transforms, rates):
        """The base rides with the joints above it; beside it, each child moves the vertex by its
        own twist's and swing's rates, weighted. No number needs a pass over the surface."""
        split = split_joints(skeleton, pose)
        weights, motions = self._aligned(split.twists)
        blended = weights @ motions
        twisted = dualquat.apply(blended, vertices)
        swings = self._blend_swings(split.swings)
        beside = jnp.einsum("vab,vb->va", swings[:, :, :3], twisted) + swings[:, :, 3]
        r, t = transforms.rotations[self.bases], transforms.translations[self.bases]
        posed = jnp.einsum("vab,vb->va", r, beside) + t
        rows = field_rows(posed, directions, rates) * bones_below(skeleton, rates)[self.bases][:, None]
        # directions as the blended surface has them before its base moves, and before it swings
        inner = jnp.einsum("vrb,vbc->vrc", directions, r)
        innermost = jnp.einsum("vrb,vbc->vrc", inner, swings[:, :, :3])
        joints = np.array(rates.joints)
        pulled = dualquat.pull_back(blended, vertices, innermost)
        rows += weights[:, joints][:, None] * (pulled @ rates.twist.T)
        homogeneous = jnp.concatenate([twisted, jnp.ones_like(twisted[:, :1])], 1)
        levers = (inner[..., None] * homogeneous[:, None, None]).reshape(*inner.shape[:2], 12)
        return rows + self.swing[:, joints][:, None] * (levers @ rates.swing.reshape(-1, 12).T)


@checked
def swing_twist_from(skin: AbstractSkin, skeleton: Skeleton) -> SwingTwistSkin:
    """A swing-twist skin from any other: the way to it from a body with LBS weights.

    Each vertex gets the base that, with its children, has most of the vertex's influences. The
    rest goes where it acts alike: what lies further down a branch to the child it hangs on,
    everything else to the base. So where one joint moves alone, and swings, a vertex with that
    joint beside its base goes where LBS takes it.

    **Raises:** `ValueError` where the skin is for another number of bones.
    """
    rows = np.asarray(skin.influence(skeleton.num_joints))
    if rows.shape[1] != skeleton.num_joints:
        raise ValueError(
            f"The skin is for {rows.shape[1]} bones and the skeleton has {skeleton.num_joints} joints; "
            "give the skeleton that the skin was made for."
        )
    return on_best_base(rows, rows, skeleton, rows.dtype)


def with_base(weights: Float[Array, "V J"], bases: Int[Array, "V"]) -> Float[Array, "V J"]:
    """Weights of the children, and what is left of one at the base."""
    rest = 1.0 - jnp.sum(weights, 1, keepdims=True)
    return weights + jnp.where(bases[:, None] == jnp.arange(weights.shape[1]), rest, 0.0)


def on_best_base(
    swing: Float[np.ndarray, "V J"], twist: Float[np.ndarray, "V J"], skeleton: Skeleton, dtype
) -> SwingTwistSkin:
    """Influences of any bones, rows one in sum, as weights of the children of one base."""
    parents = np.array(skeleton.parents)
    hangs = parents[:, None] == np.arange(len(parents))
    swing, twist = np.asarray(swing, float), np.asarray(twist, float)
    mean = (swing + twist) / 2
    # among bases that keep as much, the one that weighs most itself
    bases = np.argmax(mean @ hangs + (1 + 1e-6) * mean, 1)
    children = hangs[:, bases].T
    below = skeleton.descent.T
    swing, twist = (np.where(children, weights @ below, 0.0) for weights in (swing, twist))
    return SwingTwistSkin(jnp.asarray(bases), jnp.asarray(swing, dtype), jnp.asarray(twist, dtype))
