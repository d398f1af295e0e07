"""Sufficient statistics: any number of weighted point pairs on a rigid bone, reduced to 21 residuals."""

import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from ...arguments import checked
from ...body.body import Posed
from ...small_matrices import apply_small, multiply_small
from .bones import AbstractBoneEnergy


class RigidMoments(AbstractBoneEnergy):
    """`sum_i w_i |T_b(i) x_i - y_i|^2`, exactly, for any number of pairs.

    The sum depends on the pairs of a bone only through the 7 x 7 moment matrix `M` of `[x; 1; y]`: with `A =
    [R, t, -I]` it is `trace(A M A^T)`, and with a factor `M = F F^T` it is `|A F|^2`, 21 numbers per bone.
    Points are centred on `origins` (rest side) and `target_origins` (observed side), so that float32 keeps its
    digits.
    """

    factors: Float[Array, "J 7 7"]
    origins: Float[Array, "J 3"]
    target_origins: Float[Array, "J 3"]

    def residual(self, posed: Posed):
        r, t = posed.transforms.rotations, posed.transforms.translations
        shift = apply_small(r, self.origins) + t - self.target_origins
        f = self.factors
        moved = multiply_small(r, f[:, :3]) + shift[:, :, None] * f[:, 3:4] - f[:, 4:]
        return moved.reshape(-1)

    def bone_jacobian(self, posed: Posed):
        """Differentiate by each bone: `a x (R F_x + (R o + t) F_1) + b F_1` for the field `(a, b)`."""
        r, t = posed.transforms.rotations, posed.transforms.translations
        f, ones = self.factors, self.factors[:, 3]
        origins = apply_small(r, self.origins) + t
        carried = multiply_small(r, f[:, :3]) + origins[:, :, None] * f[:, 3:4]
        x, y, z = carried[:, 0], carried[:, 1], carried[:, 2]
        none = jnp.zeros_like(x)
        # a x v, for each column v
        rows = [
            (none, z, -y, ones, none, none),
            (-z, none, x, none, ones, none),
            (y, -x, none, none, none, ones),
        ]
        jacobian = jnp.stack([jnp.stack(row, -1) for row in rows], 1)
        bones = jnp.arange(len(f), dtype=jnp.int32)[:, None]
        return bones, jacobian.reshape(len(f), 1, -1, 6)


@checked
def rigid_moments(
    bones: Int[Array, "C"],
    rest: Float[Array, "C 3"],
    points: Float[Array, "C 3"],
    weights: Float[Array, "C"],
    num_bones: int,
) -> RigidMoments:
    """Compute the statistics of pairs `rest (C, 3)` on `bones (C,)` and `points (C, 3)`, metres."""
    # sums over bones as products with a membership matrix, which is faster on a CPU than scatters
    member = (bones[:, None] == jnp.arange(num_bones)) * weights[:, None]
    total = jnp.sum(member, 0)[:, None]
    safe = jnp.where(total > 0, total, 1.0)
    origins, targets = member.T @ rest / safe, member.T @ points / safe
    stacked = jnp.concatenate([rest - origins[bones], jnp.ones_like(rest[:, :1]), points - targets[bones]], 1)
    products = (stacked[:, :, None] * stacked[:, None, :]).reshape(-1, 49)
    moments = (member.T @ products).reshape(-1, 7, 7)
    return RigidMoments(_semidefinite_factor(moments), origins, targets)


def _semidefinite_factor(moments: Float[Array, "J 7 7"]) -> Float[Array, "J 7 7"]:
    """Factorise `M` as `F F^T` by Cholesky's columns, skipping zero pivots.

    A bone with few pairs or none has a singular matrix.
    """
    smallest = 8 * jnp.finfo(moments.dtype).eps * jnp.diagonal(moments, axis1=1, axis2=2)
    columns, rest = [], moments
    for k in range(7):
        pivot = rest[:, k, k]
        valid = pivot > smallest[:, k]
        column = rest[:, :, k] / jnp.sqrt(jnp.where(valid, pivot, 1.0))[:, None]
        column = jnp.where(valid[:, None], column, 0.0)
        columns.append(column)
        rest = rest - column[:, :, None] * column[:, None, :]
    return jnp.stack(columns, -1)
